"""Tones and steps in what a model leaves: beside a periodogram, and beside all steps there are."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lombscargle

from hubodo.gap.screen.unnamed_terms import _find_steps, _find_tones

RATE_HZ, COUNT = 50.0, 3000


def node(seed, used=(2,)):
    """A stand-in with what is asked of a node: its times, with jitter, and its channels."""
    rng = np.random.default_rng(seed)
    t = 3.0 + (np.arange(COUNT) + rng.uniform(-0.2, 0.2, COUNT)) / RATE_HZ
    return SimpleNamespace(t=t, used=np.isin(np.arange(6), used)), rng


def best_step(t, z):
    """By brute force: the time from which another mean leaves the least squares, and what it gains."""
    gains = [-np.inf] * COUNT
    whole = np.sum((z - z.mean()) ** 2)
    for k in range(51, COUNT - 51):
        left = z[:k].var() * k + z[k:].var() * (COUNT - k)
        gains[k] = 0.5 * (whole - left)
    return t[int(np.argmax(gains))], max(gains)


@pytest.mark.parametrize(("seed", "at", "size"), [(1, 900, 0.5), (2, 2400, -0.4), (3, 1500, 0.3)])
def test_a_step_is_where_two_means_leave_the_least_squares(seed, at, size):
    here, rng = node(seed)
    z = rng.normal(0.0, 1.0, (6, COUNT))
    z[2, at:] += size
    when, gain = best_step(here.t, z[2])
    assert gain > np.log(COUNT) + 6.0, "clear enough to be found"
    assert _find_steps(here, z) == [f"step(t-{when:.2f})"]


@pytest.mark.parametrize("seed", range(4, 14))
def test_noise_has_no_step_and_no_tone(seed):
    here, rng = node(seed, range(6))
    z = rng.normal(0.0, 1.0, (6, COUNT))
    assert (_find_steps(here, z), _find_tones(here, z)) == ([], [])


def test_a_channel_that_is_not_used_is_not_looked_at():
    here, rng = node(14)
    z = rng.normal(0.0, 1.0, (6, COUNT))
    z[3, 1000:] += 2.0
    z[4] += np.sin(2.0 * np.pi * 3.0 * here.t)
    assert (_find_steps(here, z), _find_tones(here, z)) == ([], [])


@pytest.mark.parametrize(("seed", "frequency"), [(21, 0.7131), (22, 6.4002), (23, 19.117)])
def test_a_tone_is_where_lomb_and_scargle_have_it(seed, frequency):
    here, rng = node(seed)
    z = rng.normal(0.0, 1.0, (6, COUNT))
    z[2] += 0.25 * np.sin(2.0 * np.pi * frequency * here.t + rng.uniform(-3.0, 3.0))
    (found,) = _find_tones(here, z)
    near = frequency + np.linspace(-0.02, 0.02, 401)
    power = lombscargle(here.t, z[2], 2.0 * np.pi * near)
    told = float(found.removeprefix("cos(2*pi*").removesuffix("*t)"))
    assert told == pytest.approx(near[np.argmax(power)], abs=2e-4)


@pytest.mark.parametrize(("beyond", "found"), [(-1.0, 0), (1.0, 1)])
def test_a_tone_counts_from_e_to_the_eight_times_less_likely_than_the_strongest_of_noise(beyond, found):
    """A cosine of size a has a power of n a²/4, where noise of 1 sigma has 1 on average, log n at most."""
    here = SimpleNamespace(t=3.0 + np.arange(COUNT) / RATE_HZ, used=np.isin(np.arange(6), 2))
    z = np.zeros((6, COUNT))
    size = np.sqrt(4.0 * (np.log(COUNT) + 8.0 + beyond) / COUNT)
    z[2] = size * np.cos(2.0 * np.pi * 5.0 * (here.t - here.t[0]))
    assert len(_find_tones(here, z)) == found


@pytest.mark.parametrize(("beyond", "found"), [(-0.5, 0), (0.5, 1)])
def test_a_step_counts_from_e_to_the_six_for_each_place_that_it_may_have(beyond, found):
    """Half of what two means leave less of the squares: n a²/8 for one of size a in the middle."""
    here = SimpleNamespace(t=3.0 + np.arange(COUNT) / RATE_HZ, used=np.isin(np.arange(6), 2))
    z = np.zeros((6, COUNT))
    z[2, COUNT // 2 :] = np.sqrt(8.0 * (np.log(COUNT) + 6.0 + beyond) / COUNT)
    assert len(_find_steps(here, z)) == found
