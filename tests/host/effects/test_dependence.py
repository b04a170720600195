"""Derived quantities of a sensor chain: rates of temperature and steering, pulses, and selections."""

import numpy as np
import pytest

from hubodo.effects.dependence import pulse, steering_rate, temperature_rate
from hubodo.effects.sensor_chain import SensorChain

T = np.linspace(2.0, 42.0, 4001)


def chain(t=T, temperature=None, **around):
    warm = np.full(len(t), 25.0) if temperature is None else temperature
    return SensorChain(t, warm, *np.zeros((5, 3, len(t))), **around)


def test_the_temperature_rate_is_the_derivative_without_quantisation_steps():
    warm = 25.0 + 6.0 * np.sin(0.11 * T)
    inner = (T > 4.0) & (T < 40.0)
    for measured, off in ((warm, 2e-3), (np.round(16.0 * warm) / 16.0, 0.05)):
        rate = temperature_rate(chain(temperature=measured))
        np.testing.assert_allclose(rate[inner], 0.66 * np.cos(0.11 * T)[inner], atol=off)


@pytest.mark.parametrize(("seconds", "tells"), [(9.4, False), (9.9, True)])
def test_a_temperature_rate_needs_ten_seconds(seconds, tells):
    t = np.arange(0.0, seconds, 0.01)
    rate = temperature_rate(chain(t, 25.0 + 0.3 * t))
    # Both ends are excluded: means over half a second are centred on their interval.
    inner = (t > 0.3) & (t < seconds - 0.5)
    np.testing.assert_allclose(rate[inner], 0.3 if tells else 0.0, atol=1e-6)


@pytest.mark.parametrize("faster", [1.0, 0.1])
def test_the_steering_rate_is_the_derivative_of_the_curvature_and_vanishes_at_low_speed(faster):
    """Derivative of r v / (v² + (0.5 m/s)²) by differences."""
    speed, yaw_rate = faster * (1.2 + 0.9 * np.sin(0.9 * T)), 0.3 * np.cos(0.7 * T) + 0.1
    sensor_chain = chain(
        speed=speed,
        acceleration=faster * 0.81 * np.cos(0.9 * T),
        yaw_rate=yaw_rate,
        yaw_acceleration=-0.21 * np.sin(0.7 * T),
    )
    numeric = np.gradient(yaw_rate * speed / (speed**2 + 0.25), T)
    np.testing.assert_allclose(steering_rate(sensor_chain)[1:-1], numeric[1:-1], atol=1e-4)
    assert np.abs(numeric).max() > 0.05


def test_a_pulse_is_a_gaussian_at_each_full_turn():
    off = np.linspace(-3.0, 3.0, 61)
    for turns in (-2, 0, 3):
        for width in (0.2, 0.7):
            rate = pulse(off + 2.0 * np.pi * turns, width)
            np.testing.assert_allclose(rate, np.exp(-(off**2) / (2.0 * width**2)), atol=1e-9)
    assert pulse(0.0, 0.3) == 1.0


def test_a_selection_of_a_chain_has_the_samples_of_all_signals():
    rng = np.random.default_rng(2)
    arrays = {
        name: rng.standard_normal((3, len(T)))
        for name in ("rate", "rate_derivative", "force", "gyro", "accel")
    }
    around = {"angle": T + 1.0, "speed": T + 2.0, "yaw_rate": 0.3, "facing": -1.0, "supply": T + 3.0}
    whole = SensorChain(T, T + 4.0, **arrays, **around)
    whole.terms["known"] = [T]
    some = slice(10, 400, 3)
    part = whole.select(some)
    for name, value in arrays.items():
        np.testing.assert_array_equal(getattr(part, name), value[:, some])
    for name in ("t", "temperature", "angle", "speed", "supply"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[some])
    assert (part.yaw_rate, part.facing, part.heading) == (0.3, -1.0, 0.0)
    assert part.terms == {} and len(whole.t) == len(T)
