"""The band of motion of a speed input: vibration beyond it is not followed."""

import numpy as np
import pytest
from scipy.signal import csd

from hubodo.gap.problem.motion_band import _cross_power, estimate_motion_band

RATE, DURATION = 120.0, 120.0
SEEDS = range(5)


def drive(rng):
    """Return times, s, and a speed, m/s, whose acceleration is white below 1 Hz and little above."""
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    frequency = np.fft.rfftfreq(len(t), 1.0 / RATE)
    spectrum = np.array([1.0, 1.0j]) @ rng.normal(size=(2, len(frequency)))
    spectrum = spectrum / np.maximum(frequency, 0.05) / (1.0 + frequency**4)
    speed = np.fft.irfft(spectrum, len(t))
    return t, speed / np.std(speed)


def vibration(rng, t, sigma):
    """Return white noise with a resonance at 15 Hz."""
    tone = np.sin(2.0 * np.pi * 15.0 * t + np.cumsum(rng.normal(size=len(t))) * 0.2)
    return sigma * (rng.normal(size=len(t)) + 3.0 * tone)


@pytest.mark.parametrize("seed", SEEDS)
def test_two_sensors_with_vibration_of_their_own_agree_up_to_the_end_of_the_motion(seed):
    rng = np.random.default_rng(seed)
    t, speed = drive(rng)
    left, right = (speed + vibration(rng, t, 0.003) for _ in range(2))
    band = estimate_motion_band(t, left, (t, right))
    assert 1.0 < band < 10.0
    scaled = estimate_motion_band(t, left, (t, 3.0 * right))
    assert scaled == band, "a factor of the second sensor does not matter"


@pytest.mark.parametrize("seed", SEEDS)
def test_a_clock_that_runs_fast_does_not_narrow_the_band(seed):
    """A delay that grows to 0.2 s turns the phase of a motion of 2.5 Hz by half a period: no vibration."""
    rng = np.random.default_rng(seed)
    t, speed = drive(rng)
    left, right = (speed + vibration(rng, t, 0.003) for _ in range(2))
    fast = t * (1.0 + 0.0016)
    assert estimate_motion_band(t, left, (fast, right)) == estimate_motion_band(t, left, (t, right))


def test_a_dip_of_the_coherence_in_one_band_is_not_the_end_of_the_motion():
    seed = 12
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, DURATION, 1.0 / RATE)
    frequency = np.fft.rfftfreq(len(t), 1.0 / RATE)

    def noise(is_inside):
        spectrum = np.array([1.0, 1.0j]) @ rng.normal(size=(2, len(frequency)))
        return np.fft.irfft(np.where(is_inside, spectrum, 0.0), len(t))

    # 1.4 to 1.8 Hz is one band of a third of an octave.
    is_dip = (frequency > 1.4) & (frequency < 1.8)
    motion = noise((frequency < 4.0) & ~is_dip)
    left, right = (motion + noise(is_dip | (frequency >= 4.0)) for _ in range(2))
    assert 3.5 < estimate_motion_band(t, left, (t, right)) < 5.0


@pytest.mark.parametrize("seed", SEEDS)
def test_one_sensor_shows_the_end_of_the_motion_by_the_valley_before_its_vibration(seed):
    rng = np.random.default_rng(seed)
    t, speed = drive(rng)
    assert 1.0 < estimate_motion_band(t, speed + vibration(rng, t, 0.003)) < 10.0


@pytest.mark.parametrize("seed", SEEDS)
def test_white_noise_of_one_sensor_is_left_to_the_smoother(seed):
    rng = np.random.default_rng(seed)
    t, speed = drive(rng)
    assert estimate_motion_band(t, speed + 0.01 * rng.normal(size=len(t))) == np.inf


def test_a_short_record_shows_no_band():
    assert estimate_motion_band(np.arange(20.0), np.arange(20.0)) == np.inf


@pytest.mark.parametrize(("count", "segment"), [(1000, 64), (1003, 65), (1003, 90)])
def test_cross_spectra_equal_those_of_scipy(count, segment):
    seed = 9
    print(f"seed {seed}")
    a, b = np.random.default_rng(seed).normal(3.0, 1.0, (2, count))
    for first, second in ((a, b), (a, a)):
        expected = csd(first, second, nperseg=segment)[1].real
        np.testing.assert_allclose(_cross_power(first, second, segment), expected, rtol=1e-9, atol=1e-12)
