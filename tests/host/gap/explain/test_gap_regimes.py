"""Identification of the regime in which a residual occurs: spin, turns, temperature, time, tones."""

import numpy as np
import pytest

from hubodo.gap.explain.regimes import Regimes, Trajectory, describe_interval

T = np.arange(0.0, 100.0, 0.01)
SPIN_RATE = 8.0 + 4.0 * np.sin(0.2 * T) + 2.0 * np.sin(0.71 * T + 1.0)
WHEEL_ANGLE = np.cumsum(SPIN_RATE) * 0.01
YAW_RATE = 0.5 * np.sin(0.13 * T) + 0.3 * np.sin(0.55 * T)
TEMPERATURE = 25.0 + 4.0 * np.sin(0.031 * T)
TRAJECTORY = Trajectory(
    T,
    WHEEL_ANGLE,
    SPIN_RATE,
    np.gradient(SPIN_RATE, T),
    0.3 * SPIN_RATE,
    np.gradient(0.3 * SPIN_RATE, T),
    YAW_RATE,
    np.gradient(YAW_RATE, T),
    TEMPERATURE,
)
SERIES_BY_REGIME = {
    "all the time": np.ones_like(T),
    "in proportion to the spin": SPIN_RATE,
    "with the square of the spin": SPIN_RATE**2,
    "with the cube of the spin": SPIN_RATE**3,
    "only while the spin rate changes": np.gradient(SPIN_RATE, T),
    "in turns": YAW_RATE,
    "in turns, to either side alike": YAW_RATE**2,
    "in turns at speed": YAW_RATE * SPIN_RATE,
    "only while turns begin and end": np.gradient(YAW_RATE, T),
    "with the temperature": TEMPERATURE - 25.0,
    "more and more with time": T,
    "once per revolution": np.cos(WHEEL_ANGLE + 1.0),
    "once per revolution, in turns": YAW_RATE * np.cos(WHEEL_ANGLE + 1.0),
    "once per revolution, with the square of the spin": SPIN_RATE**2 * np.cos(WHEEL_ANGLE),
    "twice per revolution": np.sin(2.0 * WHEEL_ANGLE),
    "three times per revolution": np.cos(3.0 * WHEEL_ANGLE),
    "as it settles after the start, in some 15 s": -np.expm1(-T / 15.0),
    "from 83 s on": (T >= 83.0).astype(float),
    "as a tone at 12.5 Hz": np.sin(2.0 * np.pi * 12.5 * T + 0.3),
}


@pytest.mark.parametrize("regime", SERIES_BY_REGIME)
def test_the_regime_of_a_noiseless_series_is_found(regime):
    assert Regimes(TRAJECTORY).find_regime(SERIES_BY_REGIME[regime]).description == regime


@pytest.mark.parametrize("regime", SERIES_BY_REGIME)
def test_the_regime_of_a_series_below_the_noise_is_found(regime):
    seed = 7
    noise = np.random.default_rng(seed).standard_normal(len(T))
    signal = SERIES_BY_REGIME[regime] / np.sqrt(np.mean(SERIES_BY_REGIME[regime] ** 2))
    assert Regimes(TRAJECTORY).find_regime(0.5 * signal + noise, 1.0).description == regime, seed


@pytest.mark.parametrize(
    ("share", "expected_text"), [(0.2, "with the temperature, among others"), (0.02, "at no particular time")]
)
def test_a_regime_with_a_small_share_is_qualified_and_one_with_a_tiny_share_is_not_named(
    share, expected_text
):
    seed = 9
    noise = np.random.default_rng(seed).standard_normal(len(T))
    signal = SERIES_BY_REGIME["with the temperature"] / np.sqrt(
        np.mean(SERIES_BY_REGIME["with the temperature"] ** 2)
    )
    series = np.sqrt(share) * signal + np.sqrt(1.0 - share) * noise
    assert Regimes(TRAJECTORY).find_regime(series).description == expected_text, seed


def test_white_noise_belongs_to_no_regime():
    seed = 8
    noise = np.random.default_rng(seed).standard_normal(len(T))
    result = Regimes(TRAJECTORY).find_regime(noise, 1.0)
    assert result.share < 0.3
    assert result.description.startswith("at no particular time") or "among others" in result.description, (
        seed
    )


def test_a_short_interval_is_described_and_the_whole_log_is_not():
    assert describe_interval(T, np.where((T > 20.0) & (T < 30.0), np.sin(T), 0.0)) == "between 20 and 30 s"
    assert describe_interval(T, np.ones_like(T)) == ""
