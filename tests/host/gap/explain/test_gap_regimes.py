"""What a series goes with is said rightly: spin, turns, revolutions, temperature, time, tones."""

import numpy as np
import pytest

from hubodo.gap.explain.regimes import Regimes, Trajectory, describe_interval

T = np.arange(0.0, 100.0, 0.01)
SPIN = 8.0 + 4.0 * np.sin(0.2 * T) + 2.0 * np.sin(0.71 * T + 1.0)
ANGLE = np.cumsum(SPIN) * 0.01
YAW = 0.5 * np.sin(0.13 * T) + 0.3 * np.sin(0.55 * T)
WARM = 25.0 + 4.0 * np.sin(0.031 * T)
COURSE = Trajectory(
    T,
    ANGLE,
    SPIN,
    np.gradient(SPIN, T),
    0.3 * SPIN,
    np.gradient(0.3 * SPIN, T),
    YAW,
    np.gradient(YAW, T),
    WARM,
)
CASES = {
    "all the time": np.ones_like(T),
    "in proportion to the spin": SPIN,
    "with the square of the spin": SPIN**2,
    "with the cube of the spin": SPIN**3,
    "only while the spin rate changes": np.gradient(SPIN, T),
    "in turns": YAW,
    "in turns, to either side alike": YAW**2,
    "in turns at speed": YAW * SPIN,
    "only while turns begin and end": np.gradient(YAW, T),
    "with the temperature": WARM - 25.0,
    "more and more with time": T,
    "once per revolution": np.cos(ANGLE + 1.0),
    "once per revolution, in turns": YAW * np.cos(ANGLE + 1.0),
    "once per revolution, with the square of the spin": SPIN**2 * np.cos(ANGLE),
    "twice per revolution": np.sin(2.0 * ANGLE),
    "three times per revolution": np.cos(3.0 * ANGLE),
    "as it settles after the start, in some 15 s": -np.expm1(-T / 15.0),
    "from 83 s on": (T >= 83.0).astype(float),
    "as a tone at 12.5 Hz": np.sin(2.0 * np.pi * 12.5 * T + 0.3),
}


@pytest.mark.parametrize("words", CASES)
def test_a_change_is_told_by_what_made_it(words):
    assert Regimes(COURSE).find_regime(CASES[words]).words == words


@pytest.mark.parametrize("words", CASES)
def test_it_is_told_below_the_noise_too(words):
    seed = 7
    noise = np.random.default_rng(seed).standard_normal(len(T))
    change = CASES[words] / np.sqrt(np.mean(CASES[words] ** 2))
    assert Regimes(COURSE).find_regime(0.5 * change + noise, 1.0).words == words, seed


@pytest.mark.parametrize(
    ("share", "words"), [(0.2, "with the temperature, among others"), (0.02, "at no particular time")]
)
def test_what_explains_little_is_one_among_others_and_what_explains_hardly_anything_is_not_named(
    share, words
):
    seed = 9
    noise = np.random.default_rng(seed).standard_normal(len(T))
    change = CASES["with the temperature"] / np.sqrt(np.mean(CASES["with the temperature"] ** 2))
    assert (
        Regimes(COURSE).find_regime(np.sqrt(share) * change + np.sqrt(1.0 - share) * noise).words == words
    ), seed


def test_noise_goes_with_nothing():
    seed = 8
    noise = np.random.default_rng(seed).standard_normal(len(T))
    found = Regimes(COURSE).find_regime(noise, 1.0)
    assert found.share < 0.3
    assert found.words.startswith("at no particular time") or "among others" in found.words, seed


def test_a_short_stretch_is_named():
    assert describe_interval(T, np.where((T > 20.0) & (T < 30.0), np.sin(T), 0.0)) == "between 20 and 30 s"
    assert describe_interval(T, np.ones_like(T)) == ""
