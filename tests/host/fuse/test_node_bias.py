"""The bias that a node told of itself as a prior: used where no calibration knows it, and no worse for it."""

import math

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.calibration.file import CalibratedEffect, Calibration, NodeCalibration, Quantity
from hubodo.fuse.node_bias import add_node_biases
from hubodo.fuse.wheel_odometry import compute_wheel_odometry
from hubodo.recording import BIAS_FILTER_COLUMNS, Recording, Table
from hubodo.vehicle import NodeMount, Vehicle

VEHICLE = Vehicle(0.15, 0.5, {"left": NodeMount("left", "left"), "right": NodeMount("right", "right")})
COLUMNS = ("t", "gx", "gy", "gz", "ax", "ay", "az")
WAITING, TRACKING = 0.0, 2.0


def said(*rows):
    """A table of (state, bias, sigma) as a node tells them five times a second."""
    made = {name: np.zeros(len(rows)) for name in BIAS_FILTER_COLUMNS}
    made["t"] = 0.2 * np.arange(len(rows))
    made["state"] = np.array([row[0] for row in rows])
    for k, axis in enumerate("xyz"):
        made[f"bias_{axis}"] = np.array([row[1][k] for row in rows])
        made[f"sigma_{axis}"] = np.array([row[2][k] for row in rows])
    return Table(made)


NONE = (0.0, 0.0, 0.0)
OLD, NEW = (0.01, 0.02, 0.03), (0.02, -0.03, 0.04)
UNKNOWN = (1e-4, math.nan, 2e-4)


def test_the_last_bias_that_was_known_is_taken_with_its_sigma():
    table = said((WAITING, NONE, NONE), (TRACKING, OLD, NONE), (TRACKING, NEW, UNKNOWN), (1.0, NONE, NONE))
    made, used = add_node_biases(None, Recording({}, bias_filters={"left": table}), ("left", "right"))
    assert used == ("left",)
    told = made.nodes["left"].effects["gyro_bias"].parameters
    assert [told[axis].value for axis in "xyz"] == list(NEW)
    assert [told[axis].sigma for axis in "xyz"] == [1e-4, 0.0, 2e-4]


def test_a_node_without_a_bias_and_one_whose_bias_is_calibrated_change_nothing():
    known = Calibration(
        {"right": NodeCalibration({"gyro_bias": CalibratedEffect({"x": Quantity(0.5, 0.1)})})}
    )
    filters = {"left": said((WAITING, OLD, NONE)), "right": said((TRACKING, NEW, NONE))}
    made, used = add_node_biases(known, Recording({}, bias_filters=filters), ("left", "right"))
    assert (made, used) == (known, ())


def test_a_calibration_of_something_else_is_kept_beside_it():
    known = Calibration(
        {"left": NodeCalibration({"wheel_radius": CalibratedEffect({"error": Quantity(0.01, 0.1)})})}
    )
    recording = Recording({}, bias_filters={"left": said((TRACKING, NEW, NONE))})
    made, used = add_node_biases(known, recording, ("left",))
    assert used == ("left",) and set(made.nodes["left"].effects) == {"wheel_radius", "gyro_bias"}


@pytest.mark.parametrize("rest", [8.0, 0.3])
def test_with_what_the_nodes_told_the_track_is_no_worse(rest):
    """Drives by a generator that shares no code with the filter; the nodes told what they had at power-on."""
    found = {True: [], False: []}
    seeds = range(4)
    for seed in seeds:
        rng = np.random.default_rng(seed)
        plan = wheel_drives.loop(rng, length=60.0, rest=rest)
        drive = wheel_drives.drive(plan, rng, facing={"right": "right"})
        nodes = {
            name: Table(dict(zip(COLUMNS, [node.t, *node.gyro.T, *node.accel.T], strict=True)))
            for name, node in drive.nodes.items()
        }
        told = {
            name: said((TRACKING, [node.truth[f"bias_{axis}"] for axis in "xyz"], (1e-4, 1e-4, 1e-4)))
            for name, node in drive.nodes.items()
        }
        for with_bias in (True, False):
            recording = Recording(nodes, bias_filters=told if with_bias else {})
            made = compute_wheel_odometry(recording, VEHICLE, log="drive")
            assert made.details.get("bias_from_node") == (["left", "right"] if with_bias else None)
            x, y = (np.interp(drive.t, made.track.t, value) for value in (made.track.x, made.track.y))
            off = np.hypot(x - drive.x, y - drive.y)
            found[with_bias].append((off[-1], np.sqrt(np.mean(off**2))))
    told, untold = (np.median(found[key], axis=0) / 60.0 for key in (True, False))
    print(f"seeds {seeds}, rest {rest} s: final, rms of the path: told {told}, not told {untold}")
    assert (told < 1.02 * untold + 1e-4).all()
