"""Exchanged or negated axes of a node are named and corrected; correct nodes stay as they are."""

import re
from dataclasses import replace

import numpy as np
import pytest

from generators import fault_drives, wheel_drives
from hubodo.errors import CalibrationError
from hubodo.fuse.wheel.calibration.calibrate import calibrate_wheels
from hubodo.fuse.wheel.calibration.positions import Positions
from hubodo.fuse.wheel.node_screening import is_mirrored
from hubodo.fuse.wheel.track import run_wheel_filter
from wheel_runs import BOTH, config, end_error, short_loop, tables

SEED = 100
MIRRORED = {
    "x and y exchanged": fault_drives.EXCHANGED_AXES,
    "x negated": [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    "y negated": [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]],
}


@pytest.fixture(scope="module")
def drive() -> wheel_drives.WheelDrive:
    return short_loop(SEED)


def remap(drive: wheel_drives.WheelDrive, names: tuple[str, ...], matrix: list[list[float]]):
    turned = np.array(matrix).T
    nodes = {
        name: replace(
            drive.nodes[name], gyro=drive.nodes[name].gyro @ turned, accel=drive.nodes[name].accel @ turned
        )
        for name in names
    }
    return replace(drive, nodes={**drive.nodes, **nodes})


@pytest.mark.parametrize("matrix", MIRRORED.values(), ids=MIRRORED)
@pytest.mark.parametrize("names", [("left",), BOTH])
def test_mirrored_axes_are_named_and_give_the_track_of_correct_ones(drive, names, matrix) -> None:
    correct = run_wheel_filter(config(drive), tables(drive))
    wrong = remap(drive, names, matrix)
    run = run_wheel_filter(config(wrong), tables(wrong))
    named = [line for line in run.report.warnings if "gravity rotates against gz" in line]
    assert [line.split(":")[0] for line in named] == list(names)
    assert end_error(wrong, run) == pytest.approx(end_error(drive, correct), abs=1e-3), SEED


@pytest.mark.parametrize("facing", ["left", "right"])
def test_a_correct_node_is_not_mirrored_whichever_way_it_faces(drive, facing) -> None:
    node = replace(config(drive).nodes["left"], facing=facing)
    assert not is_mirrored(node, tables(drive)["left"])


def test_a_calibration_of_mirrored_axes_is_refused(drive) -> None:
    wrong = remap(drive, ("right",), MIRRORED["y negated"])
    t = np.arange(1.0, drive.t[-1] - 1.0, 0.5)
    positions = Positions(
        t, np.interp(t, drive.t, drive.x), np.interp(t, drive.t, drive.y), np.full(len(t), 0.02)
    )
    with pytest.raises(CalibrationError, match="right: gravity rotates against gz"):
        calibrate_wheels(config(wrong), tables(wrong), positions)


@pytest.mark.parametrize(
    ("factor", "text"), [(1.2, "show 0.[45][0-9]* m instead of 0.6 m"), (0.8, "fit 0.(49|5) m better")]
)
def test_a_track_width_that_is_a_fifth_off_is_named(factor, text) -> None:
    bends = [(8.0, 1.2, turn) for turn in (0.5, -0.5, 0.4, -0.4)]
    plan = wheel_drives.legs([(5.0, 0.0, 0.0), *bends, (3.0, 0.0, 0.0)])
    turning = wheel_drives.drive(plan, np.random.default_rng(SEED))
    run = run_wheel_filter(config(turning, track_width=factor * turning.track), tables(turning))
    assert any(re.search(text, line) for line in run.report.warnings), run.report.warnings
