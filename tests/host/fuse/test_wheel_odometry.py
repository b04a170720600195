"""Odometry of a recording: the choice of nodes, the start heading, wheel speeds alone."""

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.fuse.wheel_nodes import select_wheel_nodes
from hubodo.fuse.wheel_odometry import compute_wheel_odometry, read_start_heading
from hubodo.recording import Recording, Table
from hubodo.vehicle import NodeMount, Vehicle

T = np.arange(0.0, 10.05, 0.1)
NODE = Table({"t": T, **dict.fromkeys(("gx", "gy", "gz", "ax", "ay", "az"), 0.0 * T)})
NODES = {"left": NodeMount("left", "left"), "right": NodeMount("right", "left"), "body": NodeMount()}
VEHICLE = Vehicle(0.2, 0.5, NODES)


def test_nodes_on_wheels_that_the_log_has_are_selected():
    recording = Recording({"left": NODE, "body": NODE})
    assert select_wheel_nodes(recording, VEHICLE, None, "log") == ("left",)
    for wanted, message in (("body", "not on a wheel"), ("right", "no node 'right' in the log")):
        with pytest.raises(InputError, match=message):
            select_wheel_nodes(recording, VEHICLE, [wanted], "log")
    with pytest.raises(InputError, match="none of the vehicle's wheel nodes"):
        select_wheel_nodes(Recording({"body": NODE}), VEHICLE, None, "log")


def test_the_start_heading_is_that_of_truth_before_that_of_a_compass():
    compass = Table({"t": T, "heading": 0.1 * T})
    truth = Table({"t": T, "x": T, "y": T, "heading": np.full(len(T), 2.0)})
    assert read_start_heading(Recording({}), 0.0) is None
    assert read_start_heading(Recording({}, heading=compass), 5.0) == pytest.approx(0.5)
    assert read_start_heading(Recording({}, heading=compass, truth=truth), 5.0) == 2.0


def test_wheel_speeds_alone_give_a_track():
    """The wheels roll at 1.0 and 1.2 m/s: 1.1 m/s and a yaw rate of 0.4 rad/s on a track of 0.5 m."""
    wheels = Table({"t": T, "left": 0.0 * T + 1.0, "right": 0.0 * T + 1.2})
    odometry = compute_wheel_odometry(Recording({}, wheels=wheels), VEHICLE, log="log")
    assert odometry.nodes == () and odometry.details["distance"] == pytest.approx(11.0)
    assert odometry.track.heading[-1] == pytest.approx(4.0)
    assert odometry.track.yaw_rate == pytest.approx(np.append(0.0, np.full(len(odometry.track.t) - 1, 0.4)))


def test_the_error_of_a_log_without_usable_samples_gives_the_cause():
    """The left node froze with the first sample, while the right one turned; that one has six samples."""
    t = np.arange(0.0, 10.0, 0.01)
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    frozen = Table({"t": t, **{name: np.full(len(t), 5.0) for name in names}})
    short = Table({"t": t[101:107], **{name: np.arange(6.0) for name in names}})
    with pytest.raises(InputError, match=r"nothing to filter; left: from .* not one bit .* it froze"):
        compute_wheel_odometry(Recording({"left": frozen, "right": short}), VEHICLE, log="log")
