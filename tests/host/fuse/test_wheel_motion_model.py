"""Propagation of states and covariance through a window: against arcs, differences and declared noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    HEADING,
    RATE_BEYOND_RANGE,
    SPEED,
    TIME_OFFSET,
    WHEEL_ANGLE,
    YAW_RATE,
    X,
    Y,
)
from hubodo.fuse.wheel.motion_model import MotionModel
from hubodo.fuse.wheel.window import WINDOW_S
from wheel_runs import BOTH
from wheel_windows import make_vehicle, random_state, replace_windows

T = WINDOW_S


def transition_matrix(motion: MotionModel, n_states: int) -> np.ndarray:
    """Return the derivatives (n, n) of the states after the last propagation by those before it."""
    change, matrix = motion.transition(), np.eye(n_states)
    matrix[change.columns] = change.rows(n_states)
    return matrix


@pytest.mark.parametrize("names", [BOTH, ("right",)])
@pytest.mark.parametrize(("speed", "yaw_rate"), [(3.0, 2.0), (-3.0, 2.0), (1.0, -0.5)])
@pytest.mark.parametrize("clipped", [0.0, 1.0])
def test_a_vehicle_moves_along_an_arc_and_wheel_angles_integrate_the_corrected_gyros(
    names: tuple[str, ...], speed: float, yaw_rate: float, clipped: float
) -> None:
    config, initial, pairs = make_vehicle(*names)
    pairs = replace_windows(pairs, spin_clipped=clipped)
    before, p = random_state(initial, 5)
    columns = initial.columns.vehicle
    before[columns[SPEED]], before[columns[YAW_RATE]], before[columns[HEADING]] = speed, yaw_rate, 0.7
    for wheel in initial.wheels:
        before[wheel.columns[CAMBER]] = 0.2
    x = before.tolist()
    MotionModel(config, initial).advance(x, p, pairs)
    expected = before.copy()
    end_heading = 0.7 + yaw_rate * T
    expected[columns[HEADING]] = end_heading
    # Equal up to the fourth order of the arc angle, 0.2 rad.
    expected[columns[X]] += speed / yaw_rate * (math.sin(end_heading) - math.sin(0.7))
    expected[columns[Y]] -= speed / yaw_rate * (math.cos(end_heading) - math.cos(0.7))
    for entry, column in columns.items():
        expected[column] *= math.exp(-T / entry.correlation_time)
    for wheel, window in pairs:
        wheel_states = {entry: before[column] for entry, column in wheel.columns.items()}
        rate = window.spin / T
        if not clipped:
            rate = (rate - wheel_states[GYRO_BIAS_Z]) / (1.0 + wheel_states[GYRO_SCALE_Z])
        rate += wheel_states[RATE_BEYOND_RANGE] - wheel.geometry.side * yaw_rate * math.sin(0.2)
        expected[wheel.columns[WHEEL_ANGLE]] += rate * T
    assert x == pytest.approx(expected, abs=3e-7)


def test_a_wheel_angle_stays_within_half_a_turn() -> None:
    config, initial, pairs = make_vehicle("left")
    x, column = list(initial.x), initial.wheels[0].columns[WHEEL_ANGLE]
    x[column] = 3.0
    MotionModel(config, initial).advance(x, initial.p, pairs)
    assert x[column] == pytest.approx(3.0 + 0.6 - 2.0 * math.pi)


@pytest.mark.parametrize("names", [BOTH, ("right",)])
@pytest.mark.parametrize("clipped", [0.0, 1.0])
def test_the_transition_matrix_is_the_derivative_of_the_motion(
    names: tuple[str, ...], clipped: float
) -> None:
    config, initial, pairs = make_vehicle(*names)
    pairs = replace_windows(pairs, spin_clipped=clipped)
    before, p = random_state(initial, 6)
    columns = initial.columns.vehicle
    before[columns[SPEED]], before[columns[YAW_RATE]], before[columns[HEADING]] = 3.0, 0.1, 0.7
    motion = MotionModel(config, initial)

    def propagate(x: np.ndarray) -> np.ndarray:
        state = x.tolist()
        motion.advance(state, p.copy(), pairs)
        return np.array(state)

    step = 1e-5
    numeric = [
        (propagate(before + step * unit) - propagate(before - step * unit)) / (2.0 * step)
        for unit in np.eye(len(before))
    ]
    propagate(before)
    # The transition neglects that the yaw rate shortens the chord of an arc: v T² (r T) / 12.
    np.testing.assert_allclose(transition_matrix(motion, len(before)), np.array(numeric).T, atol=3e-5)


@pytest.mark.parametrize("names", [BOTH, ("right",)])
@pytest.mark.parametrize("speed", [3.0, -3.0])
@pytest.mark.parametrize(("missing", "gyro"), [(0.0, 0.0), (0.0, 4e-4), (0.3, 0.0)])
def test_the_covariance_follows_the_transition_and_the_declared_process_noise(
    names: tuple[str, ...], speed: float, missing: float, gyro: float
) -> None:
    """Process noise: random walks, 1 mm per root metre sideways, gyro noise, 1 rad/s for a missing part."""
    config, initial, pairs = make_vehicle(*names)
    pairs = replace_windows(pairs, missing=missing)
    before, p = random_state(initial, 7)
    columns = initial.columns.vehicle
    before[columns[SPEED]], before[columns[YAW_RATE]], before[columns[HEADING]] = speed, 0.5, 0.7
    for wheel in initial.wheels:
        wheel.standstill.noise = gyro
    motion, second = MotionModel(config, initial), p.copy()
    for number in range(2):
        x = before.tolist()
        motion.advance(x, second, pairs)
        if number == 0:
            first = second.copy()
    f = transition_matrix(motion, len(before))
    noise = np.zeros_like(p)
    for wheel in initial.wheels:
        for entry, column in wheel.columns.items():
            if entry is TIME_OFFSET and len(names) == 1:
                continue
            is_random_walk = math.isinf(entry.correlation_time)
            noise[column, column] = (
                entry.random_walk**2 * T
                if is_random_walk
                else entry.prior**2 * -math.expm1(-2.0 * T / entry.correlation_time)
            )
        angle = wheel.columns[WHEEL_ANGLE]
        noise[angle, angle] = max(config.noise.gyro**2 * T, gyro * T * T) + (missing * T) ** 2
    sideways = np.array([-math.sin(0.7 + 0.025), math.cos(0.7 + 0.025)])
    xy = [columns[X], columns[Y]]
    noise[np.ix_(xy, xy)] += 0.001**2 * abs(speed) * T * np.outer(sideways, sideways)
    np.testing.assert_allclose(first, f @ p @ f.T + noise, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(second, f @ first @ f.T + noise, rtol=1e-6, atol=1e-12)
    # From a zero covariance, as the process noise is small beside the covariance above.
    from_zero = np.zeros_like(p)
    MotionModel(config, initial).advance(before.tolist(), from_zero, pairs)
    np.testing.assert_allclose(from_zero, noise, rtol=1e-3, atol=1e-20)
