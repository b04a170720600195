"""Prediction of speed and yaw rate by accelerometers, and the motion states that decide it."""

from __future__ import annotations

import cmath
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hubodo.fuse.wheel.config import WheelConfig, WheelNode
from hubodo.fuse.wheel.entries import (
    CAMBER,
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    GYRO_BIAS_Z,
    GYRO_SCALE_Z,
    RATE_BEYOND_RANGE,
    SLOPE,
    SPEED,
    WHEEL_ANGLE,
    YAW_RATE,
)
from hubodo.fuse.wheel.free_motion import free_motion_variances, vehicle_motion_sigmas
from hubodo.fuse.wheel.measurements import WindowNoise
from hubodo.fuse.wheel.motion_prediction import MotionPrediction, detect_wheel_motion, vehicle_motion
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.state_vector import InitialState
from hubodo.fuse.wheel.wheel import WheelMode
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOW_S, Window
from wheel_runs import BOTH
from wheel_windows import Pairs, make_vehicle, random_state, replace_windows

T = WINDOW_S
MAX_SPEED = 1.0


def predict(
    pairs: Pairs,
    initial: InitialState,
    x: np.ndarray,
    p: np.ndarray,
    prediction: MotionPrediction | None = None,
    propagate_speed: bool = True,
    speed_aided: bool = False,
    motion_state: MotionState = MotionState.MOVING,
) -> tuple[np.ndarray, np.ndarray, MotionPrediction]:
    """Return states, covariance and the prediction object after a predicted window."""
    prediction = prediction or MotionPrediction(
        initial.columns, WindowNoise(WheelConfig(0.2, 0.6, {"a": LEFT}).noise, 0.2)
    )
    after, p = x.tolist(), p.copy()
    prediction.predict(after, p, pairs, motion_state, propagate_speed, speed_aided, MAX_SPEED)
    return np.array(after), p, prediction


LEFT = WheelNode("left", "left")


def forward_gain(wheel: Any, window: Window, x: np.ndarray) -> float:
    """Return the speed gain, m/s, by an independent copy of the model of forward.py."""
    states = {f"{entry}": x[place] for entry, place in wheel.columns.items()}
    rate = (window.spin / T - states["gyro_bias.z"]) / (1.0 + states["gyro_scale_factor.z"]) + states[
        str(RATE_BEYOND_RANGE)
    ]
    rolling_rate = rate - wheel.geometry.side * states[str(YAW_RATE)] * math.sin(states[str(CAMBER)])
    rotation = cmath.exp(1j * (states[str(WHEEL_ANGLE)] + 0.5 * rolling_rate * T))
    force = window.force - complex(states["accel_bias.x"], states["accel_bias.y"]) * window.carrier
    force -= complex(states["lever_arm.x"], states["lever_arm.y"]) * window.lever
    return (rotation * force).imag - states[str(SLOPE)] * T


@pytest.mark.parametrize("names", [BOTH, ("right",)])
def test_an_inertially_propagated_speed_integrates_the_forward_acceleration(
    names: tuple[str, ...],
) -> None:
    config, initial, pairs = make_vehicle(*names)
    before, p = random_state(initial, 8)
    speed, yaw_rate = initial.columns.vehicle[SPEED], initial.columns.vehicle[YAW_RATE]
    x, covariance, prediction = predict(pairs, initial, before, p)
    gain = np.mean([forward_gain(*pair, before) for pair in pairs])
    assert abs(gain) < 0.5, "the limit of the acceleration would hide an error"
    assert x[speed] - before[speed] == pytest.approx(gain)
    assert np.delete(x - before, speed) == pytest.approx(0.0)

    def predicted_speed(state: np.ndarray) -> float:
        return predict(pairs, initial, state, p)[0][speed]

    derivatives = [
        (predicted_speed(before + 1e-6 * u) - predicted_speed(before - 1e-6 * u)) / 2e-6
        for u in np.eye(len(before))
    ]
    assert prediction.speed_row == pytest.approx(np.array(derivatives), abs=1e-7)
    f = np.eye(len(before))
    f[speed] = derivatives
    noise = config.noise
    white = noise.accel**2 * T + (noise.vibration_share * T) ** 2 * 0.3 + (noise.forward_force * T) ** 2
    expected = f @ p @ f.T
    expected[speed, speed] += white / len(pairs)
    expected[yaw_rate, yaw_rate] += 0.5**2
    np.testing.assert_allclose(covariance, expected, atol=1e-6)
    # With two windows the gain is the mean of both.
    stronger = replace_windows(pairs, force=pairs[0][1].force + 0.02j)
    x, _, prediction = predict(stronger, initial, before, p, prediction)
    next_gain = np.mean([forward_gain(*pair, before) for pair in stronger])
    assert x[speed] - before[speed] == pytest.approx(0.5 * (gain + next_gain))
    prediction.clear_force()
    x, *_ = predict(stronger, initial, before, p, prediction)
    assert x[speed] - before[speed] == pytest.approx(next_gain)


@pytest.mark.parametrize("propagate_speed", [True, False])
@pytest.mark.parametrize("acceleration", [80j, -80j])
def test_the_predicted_acceleration_is_limited_to_five_metres_per_second_squared(
    propagate_speed: bool, acceleration: complex
) -> None:
    _, initial, pairs = make_vehicle("left")
    speed = initial.columns.vehicle[SPEED]
    _, window = pairs[0]
    upright = replace_windows(pairs, force=acceleration * T * cmath.exp(-0.5j * window.spin), lever=0j)
    x, *_ = predict(
        upright, initial, np.zeros(initial.columns.size), initial.p, propagate_speed=propagate_speed
    )
    assert x[speed] == pytest.approx(math.copysign(5.0, acceleration.imag) * T)


def test_unusable_accelerometers_do_not_contribute_to_the_propagated_speed() -> None:
    _, initial, pairs = make_vehicle(*BOTH)
    before, p = random_state(initial, 9)
    speed, yaw_rate = initial.columns.vehicle[SPEED], initial.columns.vehicle[YAW_RATE]
    gain_of_first = forward_gain(*pairs[0], before)
    for unusable in ({"missing": 0.01}, {"force_clipped": 0.01}):
        mixed = (pairs[0], *replace_windows(pairs[1:], **unusable))
        assert predict(mixed, initial, before, p)[0][speed] - before[speed] == pytest.approx(gain_of_first)
        x, covariance, prediction = predict(replace_windows(pairs, **unusable), initial, before, p)
        assert x == pytest.approx(before) and prediction.speed_row is None
        assert covariance[speed, speed] == pytest.approx(p[speed, speed] + 0.5**2)
        assert covariance[yaw_rate, yaw_rate] == pytest.approx(p[yaw_rate, yaw_rate] + 0.5**2)
    for attribute, value in (("angle_initialised", False), ("best_mode", WheelMode.DISABLED)):
        original = getattr(initial.wheels[1], attribute)
        setattr(initial.wheels[1], attribute, value)
        assert predict(pairs, initial, before, p)[0][speed] - before[speed] == pytest.approx(gain_of_first)
        setattr(initial.wheels[1], attribute, original)


def added_variances(initial: InitialState, pairs: Pairs, **options: bool) -> tuple[float, float]:
    """Return the variances that a window adds to speed and yaw rate."""
    size = initial.columns.size
    _, p, _ = predict(pairs, initial, np.zeros(size), np.zeros((size, size)), **options)  # type: ignore[arg-type]
    added = p.diagonal()[[initial.columns.vehicle[SPEED], initial.columns.vehicle[YAW_RATE]]]
    assert p.sum() == pytest.approx(added.sum())
    return float(added[0]), float(added[1])


def test_process_noise_depends_on_whether_speed_and_yaw_rate_are_measured() -> None:
    _, initial, pairs = make_vehicle(*BOTH)
    unmeasured = free_motion_variances(vehicle_motion_sigmas(MAX_SPEED))
    measured, missing_window = 0.25, Window(missing=0.5)
    assert max(unmeasured) < 0.5 * measured
    one_received = (pairs[0], (initial.wheels[1], missing_window))
    none_received = tuple((wheel, missing_window) for wheel in initial.wheels)
    propagation = {"propagate_speed": True, "speed_aided": False}
    for angle_known, received, speed_aided, expected in (
        (True, pairs, False, (measured, measured)),
        (False, pairs, False, (measured, measured)),
        (True, one_received, False, (measured, measured)),
        (False, one_received, False, (measured, unmeasured[1])),
        (False, one_received, True, (measured, measured)),
        (True, none_received, False, unmeasured),
        (False, none_received, False, unmeasured),
        (False, none_received, True, (measured, measured)),
    ):
        for wheel in initial.wheels:
            wheel.angle_initialised = angle_known
        assert added_variances(
            initial, received, propagate_speed=False, speed_aided=speed_aided
        ) == pytest.approx(expected)
        if received is not pairs:
            speed_variance, yaw_variance = added_variances(initial, received, **propagation)
            assert yaw_variance == pytest.approx(
                measured if angle_known and received is one_received else unmeasured[1]
            )
            # A speed propagated by an accelerometer gets no large process noise.
            assert (speed_variance == pytest.approx(measured)) != (angle_known and received is one_received)


@pytest.mark.parametrize("names", [BOTH, ("left",)])
@pytest.mark.parametrize("clipped", [0.0, 1.0])
def test_a_measured_speed_is_predicted_with_the_forward_acceleration(
    names: tuple[str, ...], clipped: float
) -> None:
    """The force is rotated at the middle of the window and reduced by the slope; no lever arm, no bias."""
    _, initial, pairs = make_vehicle(*names)
    pairs = replace_windows(pairs, spin_clipped=clipped)
    before, p = random_state(initial, 10)
    x, _, prediction = predict(pairs, initial, before, p, propagate_speed=False)
    forces = []
    for wheel, window in pairs:
        rate = window.spin / T
        if not clipped:
            rate = (rate - before[wheel.columns[GYRO_BIAS_Z]]) / (1.0 + before[wheel.columns[GYRO_SCALE_Z]])
        rate += before[wheel.columns[RATE_BEYOND_RANGE]]
        angle = before[wheel.columns[WHEEL_ANGLE]] + 0.5 * rate * T
        forces.append((window.force * cmath.exp(1j * angle)).imag)
    columns = initial.columns.vehicle
    gain = np.mean(forces) - before[columns[SLOPE]] * T
    assert abs(gain) < 0.5
    assert x[columns[SPEED]] - before[columns[SPEED]] == pytest.approx(gain)
    assert prediction.speed_row is None and prediction.reset_states == []


@pytest.mark.parametrize(
    ("motion_state", "sigmas"), [(MotionState.STANDSTILL, (1e-3, 1e-4)), (MotionState.ROCKING, (0.03, 0.03))]
)
def test_standstill_resets_speed_and_yaw_rate_without_correlation_to_the_past(
    motion_state: MotionState, sigmas: tuple[float, float]
) -> None:
    _, initial, pairs = make_vehicle(*BOTH)
    before, p = random_state(initial, 11)
    speed_columns = [initial.columns.vehicle[SPEED], initial.columns.vehicle[YAW_RATE]]
    _, _, prediction = predict(pairs, initial, before, p)
    x, covariance, prediction = predict(
        pairs, initial, before, p, prediction, propagate_speed=False, motion_state=motion_state
    )
    expected, mean = p.copy(), before.copy()
    expected[speed_columns], expected[:, speed_columns], mean[speed_columns] = 0.0, 0.0, 0.0
    expected[speed_columns, speed_columns] = np.square(sigmas)
    np.testing.assert_allclose(covariance, expected)
    assert x == pytest.approx(mean)
    assert prediction.reset_states == speed_columns
    # The force before the standstill does not enter the mean after it.
    stronger = replace_windows(pairs, force=pairs[0][1].force + 0.02j)
    gain = predict(stronger, initial, before, p, prediction)[0][speed_columns[0]] - before[speed_columns[0]]
    assert gain == pytest.approx(np.mean([forward_gain(*pair, before) for pair in stronger]))


def test_wheel_motion_is_detected_with_the_biases_and_their_largest_sigma() -> None:
    _, initial, pairs = make_vehicle(*BOTH)
    before, p = random_state(initial, 12)
    for least_known in (GYRO_BIAS_X, GYRO_BIAS_Y, GYRO_BIAS_Z):
        calls = []
        for wheel in initial.wheels:
            wheel.standstill = SimpleNamespace(
                detect=lambda *args, calls=calls: calls.append(args) or args[1]
            )  # type: ignore[assignment]
            for entry in (GYRO_BIAS_X, GYRO_BIAS_Y, GYRO_BIAS_Z):
                p[wheel.columns[entry], wheel.columns[entry]] = 0.04 if entry is least_known else 0.01
        states = detect_wheel_motion(pairs, before.tolist(), p)
        for (wheel, window), args, state in zip(pairs, calls, states, strict=True):
            bias = {entry: before[place] for entry, place in wheel.columns.items()}
            across = complex(bias[GYRO_BIAS_X], bias[GYRO_BIAS_Y])
            assert args == (window, state, across, pytest.approx(0.2)) and state == bias[GYRO_BIAS_Z]


def test_the_vehicle_moves_as_its_most_moving_wheel_that_does_not_slip() -> None:
    moving, rocking, resting = MotionState.MOVING, MotionState.ROCKING, MotionState.STANDSTILL
    assert vehicle_motion([resting, rocking], [False, False]) is rocking
    assert vehicle_motion([moving, resting], [True, False]) is resting
    assert vehicle_motion([moving, resting], [False, True]) is moving
    assert vehicle_motion([resting, resting], [True, True]) is moving
    assert EMPTY_WINDOW.missing == 1.0


def test_the_speed_spreads_like_lasting_braking_only_while_no_wheel_shows_its_spin() -> None:
    _, initial, pairs = make_vehicle(*BOTH)
    x, p = random_state(initial, 5)
    speed = initial.columns.vehicle[SPEED]
    growth = []
    for blind in ((0, 0), (20, 0), (20, 30)):
        windows = tuple(
            (wheel, window._replace(force_clipped=1.0, blind_windows=count))
            for (wheel, window), count in zip(pairs, blind, strict=True)
        )
        _, after, _ = predict(windows, initial, x, p, propagate_speed=False)
        growth.append(after[speed, speed] - p[speed, speed])
    assert growth[0] == growth[1]
    assert growth[2] - growth[0] == pytest.approx(2.0 * 20 * (3.0 * T) ** 2)
