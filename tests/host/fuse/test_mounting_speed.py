"""Speeds of a mounting: from there on the simulated sensors clip, and not below."""

import json
import math

import numpy as np
import pytest

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.mounting_speed import LISTED_ARMS, mounting_speeds
from hubodo.log.log_writer import LogWriter
from hubodo.vehicle import NodeMount, Vehicle
from in_process import hubodo
from vehicles import vehicle_toml

RADIUS, GYRO_RANGE, ACCEL_RANGE = 0.3, math.radians(2000.0), 16.0 * STANDARD_GRAVITY
ANGLES = np.linspace(0.0, 2.0 * np.pi, 360)


def _clipped_axes(speed: float, arm: float, direction: float) -> np.ndarray:
    """Return the number of axes across the axle beyond the range at each wheel angle.

    direction: of the arm in the axes of the node, rad.
    """
    centripetal = (speed / RADIUS) ** 2 * arm
    forces = [centripetal * axis(direction) + STANDARD_GRAVITY * axis(ANGLES) for axis in (np.cos, np.sin)]
    return np.sum(np.abs(forces) > ACCEL_RANGE, axis=0)


def test_an_axis_stays_in_range_up_to_the_stated_speed_in_the_worst_mounting() -> None:
    vehicle = Vehicle(RADIUS, 1.4, {"left": NodeMount("left", "left"), "frame": NodeMount()})
    (speeds,) = mounting_speeds(vehicle, {})
    assert speeds.node == "left" and speeds.gyro == pytest.approx(RADIUS * GYRO_RANGE)
    assert tuple(speeds.gravity) == LISTED_ARMS
    for arm, speed in speeds.gravity.items():
        assert _clipped_axes(0.999 * speed, arm, math.pi / 4).max() < 2
        assert _clipped_axes(1.1 * speed, arm, math.pi / 4).min() == 2
        assert _clipped_axes(10.0 * speed, arm, 0.0).max() == 1, "an axis that points to the axle clips alone"


def test_info_and_vehicle_state_the_speeds_for_the_ranges_of_node_and_vehicle_file(tmp_path) -> None:
    reported = {"node.left.gyro_range_dps": "1000", "node.right.gyro_range_dps": "4000"}
    content = vehicle_toml(RADIUS, 1.4)
    with LogWriter(tmp_path / "log.mcap", t_zero_ns=0, metadata=reported) as writer:
        writer.add_attachment("vehicle.toml", "application/toml", content.encode())
    lines = hubodo("info", tmp_path / "log.mcap").out
    assert "left: the gyro about the axle clips from 5.2 m/s on" in lines
    assert "right: the gyro about the axle clips from 20.9 m/s on" in lines
    done = hubodo(
        "vehicle", "new", "--radius", "0.3 m", "--track", "1.4 m", "-o", tmp_path / "v.toml", "--json"
    )
    assert [node["gyro"] for node in json.loads(done.out)["speeds"]] == [pytest.approx(10.47, abs=0.01)] * 2
