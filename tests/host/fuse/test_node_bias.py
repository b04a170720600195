"""The gyro bias reported by a node as a prior where no calibration has one."""

import math

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.calibration.file import CalibratedEffect, Calibration, NodeCalibration, Quantity
from hubodo.fuse.wheel.config import add_node_biases
from hubodo.fuse.wheel_odometry import compute_wheel_odometry
from hubodo.recording import BIAS_FILTER_COLUMNS, Recording, Table
from hubodo.vehicle import NodeMount, Vehicle
from repetitions import first_and_more

VEHICLE = Vehicle(0.15, 0.5, {"left": NodeMount("left", "left"), "right": NodeMount("right", "right")})
COLUMNS = ("t", "gx", "gy", "gz", "ax", "ay", "az")
WAITING, TRACKING = 0.0, 2.0


def bias_table(*rows):
    """Return a table of (state, bias, sigma) as a node reports them five times a second."""
    output = {name: np.zeros(len(rows)) for name in BIAS_FILTER_COLUMNS}
    output["t"] = 0.2 * np.arange(len(rows))
    output["state"] = np.array([row[0] for row in rows])
    for k, axis in enumerate("xyz"):
        output[f"bias_{axis}"] = np.array([row[1][k] for row in rows])
        output[f"sigma_{axis}"] = np.array([row[2][k] for row in rows])
    return Table(output)


NONE = (0.0, 0.0, 0.0)
OLD, NEW = (0.01, 0.02, 0.03), (0.02, -0.03, 0.04)
UNKNOWN = (1e-4, math.nan, 2e-4)


def test_the_last_reported_bias_is_used_with_its_sigma():
    table = bias_table(
        (WAITING, NONE, NONE), (TRACKING, OLD, NONE), (TRACKING, NEW, UNKNOWN), (1.0, NONE, NONE)
    )
    output, used = add_node_biases(None, Recording({}, bias_filters={"left": table}), ("left", "right"))
    assert used == ("left",)
    reported = output.nodes["left"].effects["gyro_bias"].parameters
    assert [reported[axis].value for axis in "xyz"] == list(NEW)
    assert [reported[axis].sigma for axis in "xyz"] == [1e-4, 0.0, 2e-4]


def test_a_calibrated_bias_takes_precedence_and_a_missing_one_changes_nothing():
    known = Calibration(
        {"right": NodeCalibration({"gyro_bias": CalibratedEffect({"x": Quantity(0.5, 0.1)})})}
    )
    filters = {"left": bias_table((WAITING, OLD, NONE)), "right": bias_table((TRACKING, NEW, NONE))}
    output, used = add_node_biases(known, Recording({}, bias_filters=filters), ("left", "right"))
    assert (output, used) == (known, ())


def test_other_calibrated_effects_are_preserved():
    known = Calibration(
        {"left": NodeCalibration({"wheel_radius": CalibratedEffect({"error": Quantity(0.01, 0.1)})})}
    )
    recording = Recording({}, bias_filters={"left": bias_table((TRACKING, NEW, NONE))})
    output, used = add_node_biases(known, recording, ("left",))
    assert used == ("left",) and set(output.nodes["left"].effects) == {"wheel_radius", "gyro_bias"}


@pytest.mark.parametrize("standstill_s", first_and_more(0.3, 8.0))
def test_reported_biases_do_not_degrade_the_track(standstill_s):
    """The generator shares no code with the filter; the nodes report their bias at power-on.

    `make accuracy` has more drives.
    """
    errors = {True: [], False: []}
    seeds = range(2)
    for seed in seeds:
        rng = np.random.default_rng(seed)
        plan = wheel_drives.loop(rng, length=60.0, standstill_s=standstill_s)
        drive = wheel_drives.drive(plan, rng, facing={"right": "right"})
        nodes = {
            name: Table(dict(zip(COLUMNS, [node.t, *node.gyro.T, *node.accel.T], strict=True)))
            for name, node in drive.nodes.items()
        }
        reported = {
            name: bias_table((TRACKING, [node.truth[f"bias_{axis}"] for axis in "xyz"], (1e-4, 1e-4, 1e-4)))
            for name, node in drive.nodes.items()
        }
        for with_bias in (True, False):
            recording = Recording(nodes, bias_filters=reported if with_bias else {})
            odometry = compute_wheel_odometry(recording, VEHICLE, log="drive")
            assert odometry.details.get("bias_from_node") == (["left", "right"] if with_bias else None)
            x, y = (
                np.interp(drive.t, odometry.track.t, value) for value in (odometry.track.x, odometry.track.y)
            )
            error = np.hypot(x - drive.x, y - drive.y)
            errors[with_bias].append((error[-1], np.sqrt(np.mean(error**2))))
    reported, without_reports = (np.median(errors[key], axis=0) / 60.0 for key in (True, False))
    print(
        f"seeds {seeds}, standstill {standstill_s} s: final and rms error / distance "
        f"with reports {reported}, without {without_reports}"
    )
    assert (reported < 1.02 * without_reports + 1e-4).all()
