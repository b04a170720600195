"""The equations of one wheel's window: Jacobian by differences, residuals on a foreign rigid wheel."""

import math

import numpy as np
import pytest

from generators import wheel_drives
from hubodo.fuse.wheel import phase
from hubodo.fuse.wheel.phase import VEHICLE_STATES, WHEEL_STATES, WheelGeometry
from hubodo.fuse.wheel.preintegration import WINDOW, Window, WindowBuilder
from hubodo.fuse.wheel.sine import cosine_and_sine


def _some_window(rng: np.random.Generator, spin_rate: float) -> Window:
    normal = rng.standard_normal
    spin = spin_rate * WINDOW

    def pair(size: float) -> complex:
        return complex(*(size * normal(2)))

    rates = (spin_rate - 0.3, spin_rate + 0.5)
    force, raw = pair(0.7), pair(0.7)
    return Window(
        0,
        spin,
        *rates,
        pair(0.05),
        pair(0.05),
        force,
        0.1,
        pair(0.05),
        raw,
        0.01,
        0.3,
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
        2.0 * math.sin(0.5 * spin),
        pair(spin_rate),
    )


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("spin_rate", [0.0, 1.0, 12.0, -34.0])
def test_analytic_jacobian_equals_central_differences_for_every_state(side: float, spin_rate: float) -> None:
    rng = np.random.default_rng(int(100 + 10 * side + spin_rate))
    window = _some_window(rng, spin_rate)
    geometry = WheelGeometry(side, 0.31, 0.46 * side, 1.0)
    x = 0.1 * rng.standard_normal(VEHICLE_STATES + WHEEL_STATES)

    def residuals(states: np.ndarray) -> np.ndarray:
        values = states.tolist()
        return np.array(
            phase.wheel_rows(values[:VEHICLE_STATES], values[VEHICLE_STATES:], window, geometry)[0]
        )

    values = x.tolist()
    _, derivatives, _ = phase.wheel_rows(values[:VEHICLE_STATES], values[VEHICLE_STATES:], window, geometry)
    rows, columns = phase.jacobian_places(0, 1)
    analytic = np.zeros((phase.ROWS, len(x)))
    analytic[rows, columns] = derivatives
    step = 1e-6
    for state in range(len(x)):
        ahead, behind = x.copy(), x.copy()
        ahead[state] += step
        behind[state] -= step
        numeric = (residuals(behind) - residuals(ahead)) / (2.0 * step)
        # Truncation is step² times third derivatives of order 1; rounding 1e-16 / step.
        assert analytic[:, state] == pytest.approx(numeric, abs=1e-8), f"state {state}"


def test_centripetal_jacobian_equals_central_differences() -> None:
    rng = np.random.default_rng(5)
    window = _some_window(rng, 30.0)
    geometry = WheelGeometry(1.0, 0.31, 0.46)
    vehicle = [0.0] * VEHICLE_STATES
    x = 0.1 * rng.standard_normal(WHEEL_STATES)
    found = phase.centripetal_row(vehicle, x.tolist(), window, geometry)
    assert found is not None
    for state, derivative in found[1].items():
        values = []
        for step in (-1e-6, 1e-6):
            moved = x.copy()
            moved[state] += step
            row = phase.centripetal_row(vehicle, moved.tolist(), window, geometry)
            assert row is not None
            values.append(row[0])
        assert derivative == pytest.approx((values[0] - values[1]) / 2e-6, abs=1e-6), f"state {state}"


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("camber", [0.0, 0.3])
def test_all_residuals_vanish_at_the_true_state_of_a_rigid_wheel(side: str, camber: float) -> None:
    """The drive is differentiated numerically in the world; no equation is shared with the model."""
    seed = 11
    rng = np.random.default_rng(seed)
    plan = wheel_drives.legs([(2.0, 0.0, 0.0), (6.0, 1.5, 0.3), (6.0, 2.0, -0.4)])
    arm = (0.03, -0.02)
    drive = wheel_drives.drive(plan, rng, wheel_drives.PERFECT, camber=camber, rate_hz=1000.0, arm=arm)
    node = drive.nodes[side]
    windows = WindowBuilder("left", 0.0).add_many(node.t, node.gyro, node.accel)
    sign = 1.0 if side == "left" else -1.0
    geometry = WheelGeometry(sign, drive.radius, 0.5 * sign * drive.track)
    angle = node.truth["start_angle"]
    worst = np.zeros(phase.ROWS)
    for window in windows:
        at = slice(window.number * 100, window.number * 100 + 101)
        yaw_rate = (drive.heading[at][-1] - drive.heading[at][0]) / WINDOW
        vehicle = [0.0] * VEHICLE_STATES
        vehicle[phase.YAW_RATE], vehicle[phase.SPEED] = yaw_rate, float(np.mean(drive.speed[at]))
        states = [0.0] * WHEEL_STATES
        states[phase.ANGLE], states[phase.CAMBER] = angle, camber
        states[phase.ARM_X], states[phase.ARM_Y] = arm
        rows, _, rate = phase.wheel_rows(vehicle, states, window, geometry)
        worst = np.maximum(worst, np.abs(rows))
        angle += rate * WINDOW
    # Half a step of the chip (0.07 deg/s; 0.488 mg) over a window, plus the curvature of speed within one.
    gyro, accel = wheel_drives.GYRO_STEP * WINDOW, wheel_drives.ACCEL_STEP * WINDOW
    assert worst[phase.YAW] < gyro, f"seed {seed}"
    # The wheel angle is summed from quantised spin for 14 s: some milliradians of it turn yaw into roll.
    assert worst[phase.ROLL] < 3 * gyro
    # A lever arm of 36 mm feels w² = 170 (rad/s)² as 6 m/s²; what is left is a thousandth of it.
    assert worst[phase.FORWARD] < 20 * accel
    assert worst[phase.SIDEWAYS] < 20 * accel
    assert worst[phase.ROLLING] < 2e-4


def test_series_for_sine_and_cosine_is_as_good_as_the_library() -> None:
    angle = np.linspace(-400.0, 400.0, 100_001)
    cosine, sine = cosine_and_sine(angle)
    # Reducing 400 rad by turns costs 400 * 2^-52; the series itself is below that.
    assert np.abs(cosine - np.cos(angle)).max() < 3e-13
    assert np.abs(sine - np.sin(angle)).max() < 3e-13
