"""Motion during an outage from the wheel angles on both sides, compared with a separate integration."""

from __future__ import annotations

import math

import numpy as np
import pytest

from generators.outages import drive_with_outage
from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import HEADING, SPEED, WHEEL_ANGLE, YAW_RATE, X, Y
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.free_motion import MotionSigmas
from hubodo.fuse.wheel.outage_bridge import BridgedState, OutageBridge, OutageEnd
from hubodo.fuse.wheel.state_vector import InitialState, initial_state
from hubodo.fuse.wheel.track import run_wheel_filter
from wheel_runs import BOTH, config, pose_error, sample_columns, samples_in_time_order, tables

RADIUS, TRACK, SECONDS, MOTION_SIGMAS = 0.3, 0.6, 2.0, MotionSigmas(2.0, 0.35)
HEADING_0, ANGLES_0 = 0.7, (2.5, -1.0)


def _speed(t: np.ndarray) -> np.ndarray:
    return 1.3 + 0.2 * t


def _yaw_rate(t: np.ndarray) -> np.ndarray:
    return 0.3 - 0.1 * t


def _state(names: tuple[str, ...]) -> InitialState:
    initial = initial_state(WheelConfig(RADIUS, TRACK, {name: WheelNode(name, "left") for name in names}))  # type: ignore[arg-type]
    at = initial.columns.vehicle
    for entry, value in ((X, 3.0), (Y, -2.0), (HEADING, HEADING_0), (SPEED, 1.3), (YAW_RATE, 0.3)):
        initial.x[at[entry]] = value
    for wheel, angle in zip(initial.wheels, ANGLES_0, strict=False):
        initial.x[wheel.columns[WHEEL_ANGLE]] = angle
    return initial


def _bridge(initial: InitialState, x: list[float], angles: tuple[float, ...]) -> BridgedState:
    end = OutageEnd(angles, float(_speed(np.array(SECONDS))), float(_yaw_rate(np.array(SECONDS))))
    bridge = OutageBridge(x, initial.columns.vehicle, initial.wheels, SECONDS, MOTION_SIGMAS, end)
    return bridge.solve(roughness=0.002, lateral_slip=0.001)


def _truth() -> tuple[np.ndarray, tuple[float, ...]]:
    """Return the change of x, y, heading and the wheel angles at the end, by fine integration."""
    t = (np.arange(20_000) + 0.5) * SECONDS / 20_000
    dt = SECONDS / 20_000
    heading = HEADING_0 + np.cumsum(_yaw_rate(t)) * dt
    change = np.array(
        [*(np.sum(_speed(t) * component(heading)) * dt for component in (np.cos, np.sin)), 0.2 * SECONDS]
    )
    contacts = (0.5 * TRACK, -0.5 * TRACK)
    rolled = [np.sum(_speed(t) - _yaw_rate(t) * y) * dt / RADIUS for y in contacts]
    wrapped = [math.remainder(a + turn, 2.0 * math.pi) for a, turn in zip(ANGLES_0, rolled, strict=True)]
    return change, tuple(wrapped)


def test_two_wheels_determine_path_and_heading() -> None:
    change, angles = _truth()
    initial = _state(("left", "right"))
    at = [initial.columns.vehicle[entry] for entry in (X, Y, HEADING)]
    after = _bridge(initial, initial.x, angles)
    assert np.array(after.x)[at] - np.array(initial.x)[at] == pytest.approx(change, abs=0.003)
    # A difference of one turn is half a circle of heading, a common one 1.9 m.
    assert after.probability > 0.9
    assert math.sqrt(after.noise[at[2], at[2]]) < 0.3 * math.sqrt(2.0) * RADIUS / TRACK + 0.1


@pytest.mark.parametrize("names", [("left",), ("left", "right")])
def test_derivatives_agree_with_differences(names: tuple[str, ...]) -> None:
    initial, (_, angles) = _state(names), _truth()
    after = _bridge(initial, initial.x, angles[: len(names)])
    step = 1e-5
    for column in range(len(initial.x)):
        shifted = []
        for sign in (1.0, -1.0):
            x = list(initial.x)
            x[column] += sign * step
            shifted.append(np.array(_bridge(initial, x, angles[: len(names)]).x))
        assert after.transition[:, column] == pytest.approx(
            (shifted[0] - shifted[1]) / (2.0 * step), abs=1e-5
        )


def test_a_turn_of_both_wheels_more_or_less_is_part_of_the_covariance() -> None:
    """Wheels of 5 cm roll 0.3 m in a turn, less than the path is known to: several numbers are likely."""
    names = ("left", "right")
    initial = initial_state(WheelConfig(0.05, TRACK, {name: WheelNode(name, "left") for name in names}))  # type: ignore[arg-type]
    initial.x[initial.columns.vehicle[SPEED]] = 1.3
    after = _bridge(initial, initial.x, (0.0, 0.0))
    at = initial.columns.vehicle[X]
    assert after.probability < 0.7
    assert math.sqrt(after.noise[at, at]) > 0.2


@pytest.mark.parametrize("meanwhile", ["turns", "speeds up"])
def test_the_heading_error_stays_below_three_degrees(meanwhile: str) -> None:
    drive, end = drive_with_outage(71, 3.0, meanwhile)
    run = run_wheel_filter(config(drive, BOTH), tables(drive))
    error, covariance = pose_error(drive, run.track, int(np.searchsorted(run.track.t, end + 2.0)))
    assert len(run.filter.core.outage_ends) == 1
    assert abs(error[2]) < math.radians(3.0)
    assert error @ np.linalg.solve(covariance, error) < 14.0
    smoothed = run_wheel_filter(config(drive, BOTH), tables(drive), math.inf).track
    error, covariance = pose_error(drive, smoothed, -1)
    assert error @ np.linalg.solve(covariance, error) < 14.0


def test_live_and_bulk_return_to_an_outage_with_the_same_bits() -> None:
    drive, _ = drive_with_outage(71, 3.0, "turns")
    bulk, live = WheelFilter(config(drive)), WheelFilter(config(drive))
    poses = [*bulk.handle_blocks(sample_columns(drive)).poses, *bulk.finish().poses]
    single = [
        pose for sample in samples_in_time_order(sample_columns(drive)) for pose in live.handle(sample).poses
    ]
    single += live.finish().poses
    assert [pose[:6] for pose in poses] == [pose[:6] for pose in single]
    assert all(np.array_equal(a.covariance, b.covariance) for a, b in zip(poses, single, strict=True))
