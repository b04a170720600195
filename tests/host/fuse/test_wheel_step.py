"""What steps of the wheel filter count of a drive besides its poses, in whatever order its nodes stand."""

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.fuse.wheel.axle_rate import remove_tilt_rate
from hubodo.fuse.wheel.entries import MISALIGNMENT_X, MISALIGNMENT_Y
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.filter_core import FilterCore
from hubodo.fuse.wheel.track import run_wheel_filter
from hubodo.fuse.wheel.wheel import WheelMode
from hubodo.fuse.wheel.window import WINDOW_S, Window
from wheel_runs import BOTH, config, short, tables


def _driven(drive: wheel_drives.WheelDrive) -> FilterCore:
    made = WheelFilter(config(drive))
    made.handle_many({name: (node.t, node.gyro, node.accel) for name, node in drive.nodes.items()})
    made.finish()
    return made.core


def test_both_wheels_together_turn_by_the_way_of_the_vehicle() -> None:
    """Around a loop what one rolls less the other rolls more; radii are not quite as declared."""
    drive = short(21)
    wheels = _driven(drive).wheels
    rolled = drive.radius * np.mean([[wheel.turned_angle, wheel.net_angle] for wheel in wheels], axis=0)
    assert rolled == pytest.approx([drive.length, drive.length], rel=0.02)


@pytest.mark.parametrize("order", [BOTH, BOTH[::-1]])
@pytest.mark.parametrize("wrong", [None, *BOTH])
def test_a_node_that_faces_the_other_way_is_named_whichever_stands_first(
    order: tuple[str, str], wrong: str | None
) -> None:
    drive = short(22, facing={wrong: "right"} if wrong else {})
    said = [
        line
        for line in run_wheel_filter(config(drive, order), tables(drive)).report.warnings
        if "mounted" in line
    ]
    assert len(said) == (wrong is not None)
    assert all(f"on the {wrong} wheel" in line for line in said)


def test_of_exchanged_sides_one_wheel_is_believed_while_driving_on_the_side_that_it_is_on() -> None:
    drive = short(22)
    made, nodes = WheelFilter(config(drive)), drive.nodes
    recorded = {"left": nodes["right"], "right": nodes["left"]}
    made.handle_many({name: (node.t, node.gyro, node.accel) for name, node in recorded.items()})
    made.finish()
    declared, kept = (
        {
            wheel.name: wheel.geometry.contact_y
            for wheel in core.wheels
            if wheel.best_mode is WheelMode.ROLLING
        }
        for core in (_driven(drive), made.core)
    )
    assert len(declared) == 2
    assert len(kept) == 1
    assert all(kept[name] == -declared[name] for name in kept)


def test_the_turning_that_a_tilted_gyro_feels_is_no_spin() -> None:
    rng = np.random.default_rng(8)
    core = FilterCore(config(short(1)))
    wheel = core.wheels[0]
    for _ in range(20):
        tilt, rate = 0.02 * rng.standard_normal(2), rng.standard_normal(3)
        core.x[wheel.columns[MISALIGNMENT_X]], core.x[wheel.columns[MISALIGNMENT_Y]] = tilt
        felt = (rate - np.cross([*tilt, 0.0], rate)) * WINDOW_S
        window = Window(spin=felt[2], raw_across=complex(felt[0], felt[1]))
        found = remove_tilt_rate(core.x, wheel.columns, window).spin
        # To the first order of the tilt.
        assert (
            abs(found - rate[2] * WINDOW_S)
            < 2.0 * np.linalg.norm(tilt) ** 2 * np.linalg.norm(rate) * WINDOW_S
        )
