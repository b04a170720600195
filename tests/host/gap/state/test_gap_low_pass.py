"""Tests of the ratio of a gyro's noise in the band of motion to its scatter from sample to sample."""

from types import SimpleNamespace
from typing import cast

import numpy as np
from scipy.signal import lfilter

from hubodo.gap.state.low_pass import measure_low_pass_ratios
from hubodo.model.forward import NodeReading

RATE, SPIN = 120.0, 18.0
T = np.arange(0.0, 60.0, 1.0 / RATE)
ANGLE = SPIN * T + 0.3 * np.sin(0.5 * T)
READING = cast(NodeReading, SimpleNamespace(rolling=SimpleNamespace(angle=ANGLE)))


def _white(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 0.02, (3, len(T)))


def test_white_noise_has_a_ratio_of_one_whatever_effect_is_missing():
    unexplained = 0.8 * np.array([np.cos(ANGLE), np.sin(ANGLE), np.sin(0.2 * T)])
    assert (measure_low_pass_ratios(T, _white(1) + unexplained, READING) == 1.0).all()


def test_lagging_gyro_has_the_ratio_of_its_filter():
    # First-order recursion y += a (x - y): its gain at low frequency is one.
    for time_constant in (0.01, 0.02):
        a = 1.0 - np.exp(-1.0 / (RATE * time_constant))
        slow = lfilter([a], [1.0, a - 1.0], _white(2), axis=1)
        scatter = np.std(np.diff(slow, axis=1), axis=1) / np.sqrt(2.0)
        ratio = measure_low_pass_ratios(T, slow, READING)
        # The band of a thirtieth of a second is below, but not far below, the corner of the filter.
        assert (ratio > 0.6 * 0.02 / scatter).all()
        assert (ratio < 1.05 * 0.02 / scatter).all()


def test_outliers_and_slow_samples_leave_noise_white():
    noise = _white(3)
    noise[:, ::97] += 0.6
    assert (measure_low_pass_ratios(T, noise, READING) == 1.0).all()
    few = slice(None, None, 5)
    sparse = cast(NodeReading, SimpleNamespace(rolling=SimpleNamespace(angle=ANGLE[few])))
    assert (measure_low_pass_ratios(T[few], noise[:, few], sparse) == 1.0).all()
    assert (measure_low_pass_ratios(T[:1], noise[:, :1], READING) == 1.0).all()
