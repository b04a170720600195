"""Noise resampled from residuals: spectrum and rms by spin rate are preserved, and a seed reproduces it.

The residuals are synthetic: noise that grows with the spin, with a tone at three times the spin rate.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import welch

sys.path[:0] = [str(Path(__file__).resolve().parent)]

from residual_noise import BLOCK_S, NodeResidual, turn_over  # noqa: E402

REAL_RATE_HZ, SIMULATED_RATE_HZ, SEED = 120.0, 100.0, 5


@pytest.fixture(scope="module")
def residual():
    """120 s in which the wheel twice stands still, accelerates to 20 rad/s and slows down again."""
    rng, t = np.random.default_rng(SEED), np.arange(0.0, 120.0, 1.0 / REAL_RATE_HZ)
    spin = np.clip(12.0 - 16.0 * np.cos(2.0 * np.pi * t / 60.0), 0.0, 20.0)
    angle = np.cumsum(spin) / REAL_RATE_HZ
    white = rng.standard_normal((len(t), 6))
    tone = np.sin(3.0 * angle + rng.uniform(0.0, 6.3))[:, None] * (spin > 1.0)[:, None]
    coloured = white + 0.9 * np.vstack([np.zeros((1, 6)), white[:-1]])
    return NodeResidual(spin, coloured * (0.1 + 0.05 * spin[:, None]) + tone, REAL_RATE_HZ)


def resample(residual, spin_at_100_hz, seed=SEED):
    return residual.resample(spin_at_100_hz, SIMULATED_RATE_HZ, np.random.default_rng(seed))


@pytest.mark.parametrize("real_spin", [0.0, 8.0, 20.0])
def test_the_rms_is_that_of_the_same_spin_per_sample(residual, real_spin):
    spin = np.full(6000, real_spin * SIMULATED_RATE_HZ / REAL_RATE_HZ)
    is_near = np.abs(residual.spin - real_spin) < 0.5
    expected = np.sqrt(np.mean(residual.value[is_near] ** 2, axis=0))
    rms = np.sqrt(np.mean(resample(residual, spin) ** 2, axis=0))
    assert rms == pytest.approx(expected, rel=0.15)


def test_the_spectrum_per_sample_and_the_harmonic_of_the_spin_are_preserved(residual):
    spin = np.full(12000, 20.0 * SIMULATED_RATE_HZ / REAL_RATE_HZ)
    noise = resample(residual, spin)[:, 0]
    steady = residual.value[residual.spin == 20.0, 0]
    (frequency, power), (_, expected) = (welch(x, nperseg=256) for x in (noise, steady))
    tone = 3.0 * 20.0 / REAL_RATE_HZ / (2.0 * np.pi)
    assert frequency[np.argmax(power)] == pytest.approx(tone, abs=0.005)
    for low, high in ((0.0, 0.06), (0.06, 0.1), (0.1, 0.25), (0.25, 0.5)):
        band = (frequency >= low) & (frequency < high)
        assert np.mean(power[band]) == pytest.approx(np.mean(expected[band]), rel=0.25)


def test_noise_follows_starts_and_stops_within_a_block(residual):
    seconds = np.arange(6000) / SIMULATED_RATE_HZ
    spin = np.clip(10.0 - 14.0 * np.cos(2.0 * np.pi * seconds / 60.0), 0.0, 16.0)
    noise = resample(residual, spin)
    assert np.sqrt(np.mean(noise[spin == 0.0] ** 2)) < 0.25
    assert np.sqrt(np.mean(noise[spin == 16.0] ** 2)) == pytest.approx(
        np.sqrt(np.mean(residual.value[residual.spin > 18.0] ** 2)), rel=0.15
    )


def test_a_seed_gives_the_same_noise_and_another_seed_other_blocks(residual):
    spin = np.full(round(4.0 * BLOCK_S * SIMULATED_RATE_HZ), 9.0)
    assert np.array_equal(resample(residual, spin), resample(residual, spin))
    assert not np.array_equal(resample(residual, spin), resample(residual, spin, SEED + 1))


def test_a_node_turned_over_keeps_its_x_axis_and_its_handedness():
    gyro_and_accel = np.eye(3, 6) + np.eye(3, 6, 3)
    turned = turn_over(gyro_and_accel)
    assert np.array_equal(np.cross(turned[0, :3], turned[1, :3]), turned[2, :3])
    assert np.array_equal(turn_over(turned), gyro_and_accel)
    assert turned[0].tolist() == gyro_and_accel[0].tolist()
