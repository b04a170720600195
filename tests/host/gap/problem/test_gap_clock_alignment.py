"""Alignment of the clocks of two sensors of the same motion."""

import numpy as np
import pytest

from hubodo.gap.problem.clock_alignment import align_times

RATE, DURATION = 100.0, 120.0


def motion(t, rng):
    """Return a speed, m/s, of a drive with stops, at times t, (N,) s."""
    knots = np.arange(-5.0, DURATION + 10.0, 4.0)
    speed = np.abs(np.cumsum(rng.normal(size=len(knots))))
    at = np.arange(-5.0, DURATION + 5.0, 0.01)
    smooth = np.convolve(np.interp(at, knots, speed), np.ones(100) / 100.0, "same")
    return np.interp(t, at, smooth)


@pytest.mark.parametrize(
    ("offset", "skew"), [(0.0, 0.0), (0.04, 0.0), (-0.4, 0.0), (0.0, 1.6e-3), (0.3, -5e-3)]
)
def test_times_of_a_late_and_fast_clock_are_corrected_to_milliseconds(offset, skew):
    seed = 5
    print(f"seed {seed}")
    true_t = np.arange(0.0, DURATION, 1.0 / RATE)
    stamps = offset + true_t * (1.0 + skew)
    rng = np.random.default_rng(seed)
    turning = np.convolve(rng.normal(size=len(true_t)), np.ones(300) / 300.0, "same")
    speed = motion(true_t, np.random.default_rng(seed))
    value = speed + 0.02 * rng.normal(size=len(true_t))
    other = 1.03 * speed + turning + 0.02 * rng.normal(size=len(true_t))
    aligned = align_times(true_t, value, stamps, other, turning)
    assert np.abs(aligned - true_t).max() < 5e-3


def test_noise_and_short_records_have_finite_times():
    seed = 6
    print(f"seed {seed}")
    t = np.arange(0.0, 40.0, 0.01)
    first, second = np.random.default_rng(seed).normal(size=(2, len(t)))
    assert np.isfinite(align_times(t, first, t, second, np.zeros_like(t))).all()
    zero = np.zeros_like(t)
    np.testing.assert_allclose(align_times(t, zero, t, zero, zero), t, atol=1e-9)
    np.testing.assert_array_equal(align_times(t[:3], first[:3], t[:3], second[:3], t[:3]), t[:3])
