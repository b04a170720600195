"""Detection of tones and steps in residuals, against a periodogram and an exhaustive search."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lombscargle

from hubodo.gap.screen.unnamed_terms import _find_steps, _find_tones

RATE_HZ, N_SAMPLES = 50.0, 3000


def build_node(seed, used=(2,)):
    """Return a stand-in for a node with jittered times and a mask of used channels, and its generator."""
    rng = np.random.default_rng(seed)
    t = 3.0 + (np.arange(N_SAMPLES) + rng.uniform(-0.2, 0.2, N_SAMPLES)) / RATE_HZ
    return SimpleNamespace(t=t, used=np.isin(np.arange(6), used)), rng


def find_best_step(t, z):
    """Return time and gain of the least-squares change of the mean, by exhaustive search."""
    gains = [-np.inf] * N_SAMPLES
    total_square = np.sum((z - z.mean()) ** 2)
    for k in range(51, N_SAMPLES - 51):
        square_with_step = z[:k].var() * k + z[k:].var() * (N_SAMPLES - k)
        gains[k] = 0.5 * (total_square - square_with_step)
    return t[int(np.argmax(gains))], max(gains)


@pytest.mark.parametrize(("seed", "index", "amplitude"), [(1, 900, 0.5), (2, 2400, -0.4), (3, 1500, 0.3)])
def test_a_step_is_found_at_the_least_squares_change_point(seed, index, amplitude):
    node, rng = build_node(seed)
    z = rng.normal(0.0, 1.0, (6, N_SAMPLES))
    z[2, index:] += amplitude
    step_time, gain = find_best_step(node.t, z[2])
    assert gain > np.log(N_SAMPLES) + 6.0, "above the detection threshold"
    assert _find_steps(node, z) == [f"step(t-{step_time:.2f})"]


@pytest.mark.parametrize("seed", range(4, 14))
def test_noise_has_no_step_and_no_tone(seed):
    node, rng = build_node(seed, range(6))
    z = rng.normal(0.0, 1.0, (6, N_SAMPLES))
    assert (_find_steps(node, z), _find_tones(node, z)) == ([], [])


def test_excluded_channels_are_ignored():
    node, rng = build_node(14)
    z = rng.normal(0.0, 1.0, (6, N_SAMPLES))
    z[3, 1000:] += 2.0
    z[4] += np.sin(2.0 * np.pi * 3.0 * node.t)
    assert (_find_steps(node, z), _find_tones(node, z)) == ([], [])


@pytest.mark.parametrize(("seed", "frequency"), [(21, 0.7131), (22, 6.4002), (23, 19.117)])
def test_a_tone_is_found_at_the_peak_of_the_lomb_scargle_periodogram(seed, frequency):
    node, rng = build_node(seed)
    z = rng.normal(0.0, 1.0, (6, N_SAMPLES))
    z[2] += 0.25 * np.sin(2.0 * np.pi * frequency * node.t + rng.uniform(-3.0, 3.0))
    (expression,) = _find_tones(node, z)
    frequencies = frequency + np.linspace(-0.02, 0.02, 401)
    power = lombscargle(node.t, z[2], 2.0 * np.pi * frequencies)
    found_frequency = float(expression.removeprefix("cos(2*pi*").removesuffix("*t)"))
    assert found_frequency == pytest.approx(frequencies[np.argmax(power)], abs=2e-4)


@pytest.mark.parametrize(("margin", "n_found"), [(-1.0, 0), (1.0, 1)])
def test_the_threshold_of_a_tone_is_8_nats_above_the_strongest_expected_of_noise(margin, n_found):
    """A cosine of amplitude a has a power of n a²/4; unit noise has a mean of 1, a maximum of about ln n."""
    node = SimpleNamespace(t=3.0 + np.arange(N_SAMPLES) / RATE_HZ, used=np.isin(np.arange(6), 2))
    z = np.zeros((6, N_SAMPLES))
    amplitude = np.sqrt(4.0 * (np.log(N_SAMPLES) + 8.0 + margin) / N_SAMPLES)
    z[2] = amplitude * np.cos(2.0 * np.pi * 5.0 * (node.t - node.t[0]))
    assert len(_find_tones(node, z)) == n_found


@pytest.mark.parametrize(("margin", "n_found"), [(-0.5, 0), (0.5, 1)])
def test_the_threshold_of_a_step_is_6_nats_above_the_log_of_the_number_of_positions(margin, n_found):
    """The gain is half the reduction of the sum of squares: n a²/8 for a step of size a in the middle."""
    node = SimpleNamespace(t=3.0 + np.arange(N_SAMPLES) / RATE_HZ, used=np.isin(np.arange(6), 2))
    z = np.zeros((6, N_SAMPLES))
    z[2, N_SAMPLES // 2 :] = np.sqrt(8.0 * (np.log(N_SAMPLES) + 6.0 + margin) / N_SAMPLES)
    assert len(_find_steps(node, z)) == n_found
