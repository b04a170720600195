"""Sinusoidal and Gauss-Markov terms of IEEE 952: simulated ones are named with their size."""

import itertools

import numpy as np
import pytest
from scipy.integrate import quad

from generators.noise import gyro_noise
from generators.odd_records import correlated
from hubodo.sensors.allan.characterise import characterise_noise
from hubodo.sensors.allan.markov import MarkovNoise

DT, COUNT, N = 0.05, 1 << 16, 1e-4
T = np.arange(COUNT) * DT


def noise(seed):
    return gyro_noise(COUNT, DT, np.random.default_rng([seed, 31]), n=N, b=0.0, k=0.0)


def error_of_n(result):
    """Return the error of N in sigma."""
    term = result.terms["N"]
    return (term.value - N) / term.sigma


@pytest.mark.parametrize("tau", [0.5, 4.0, 60.0])
def test_the_allan_variance_of_a_process_is_the_integral_of_its_spectrum(tau):
    """The Allan variance is 4 ∫ S(f) sin⁴(πfτ)/(πfτ)² df (IEEE 952-1997, C.2)."""
    sigma, time = 2e-3, 5.0

    def integrand(f):
        density = 2.0 * sigma**2 * time / (1.0 + (2.0 * np.pi * f * time) ** 2)
        return 4.0 * density * np.sin(np.pi * f * tau) ** 4 / (np.pi * f * tau) ** 2

    edges = np.arange(0.0, 60.0 / min(tau, time), 0.5 / tau)
    expected = sum(quad(integrand, a + 1e-12, b)[0] for a, b in itertools.pairwise(edges))
    assert MarkovNoise(sigma, time).variance(np.array([tau]))[0] == pytest.approx(expected, rel=2e-3)


def test_lines_are_named_with_frequency_and_amplitude_and_do_not_change_the_noise():
    rng = np.random.default_rng(3)
    lines = ((0.07, 3e-4), (3.31, 2e-3))
    samples = noise(1) + sum(a * np.sin(2 * np.pi * f * T + rng.uniform(0, 6)) for f, a in lines)
    result = characterise_noise(T, samples, "gz")
    measured = sorted(result.sinusoids, key=lambda it: it.frequency)
    assert len(measured) == len(lines)
    for it, (frequency, amplitude) in zip(measured, lines, strict=True):
        assert it.frequency == pytest.approx(frequency, abs=0.1 / T[-1])
        assert abs(it.amplitude - amplitude) < 4 * it.sigma < 0.2 * amplitude
    assert abs(error_of_n(result)) < 3
    assert any("sinusoids removed: 3.31 Hz" in note for note in result.notes)
    assert len(result.as_json()["sinusoids"]) == 2
    plain = characterise_noise(T, samples, "gz", keep_all_samples=True)
    assert plain.sinusoids == () and plain.adev[0] > 2 * result.adev[0]


def test_a_line_that_changes_its_frequency_is_not_removed():
    phase = 2 * np.pi * np.cumsum(3.0 + 0.2 * np.sin(T / 300.0)) * DT
    assert characterise_noise(T, noise(2) + 3e-3 * np.sin(phase), "gz").sinusoids == ()


def test_no_line_and_no_process_is_reported_in_plain_noise():
    for seed in range(4, 8):
        result = characterise_noise(T, noise(seed), "gz")
        assert result.sinusoids == () and result.fit.markov is None


def test_noise_correlated_over_five_seconds_is_a_process_beside_the_white_noise():
    rng = np.random.default_rng([1, 32])
    result = characterise_noise(T, noise(1) + correlated(T, rng, 1.5e-4), "gz")
    process = result.fit.markov
    assert process.time == pytest.approx(5.0, rel=0.4) and process.sigma == pytest.approx(1.5e-4, rel=0.1)
    assert abs(error_of_n(result)) < 3 and result.terms["N"].sigma < 0.02 * N
    assert result.as_json()["markov"] == {"sigma": process.sigma, "correlation_time": process.time}
    assert any("first-order Gauss-Markov" in note for note in result.notes)


def test_white_noise_hidden_by_a_warm_up_is_not_given():
    """A bias that decays by 0.3 deg/s dominates every averaging time but the shortest."""
    t = np.arange(8000) * DT
    samples = np.random.default_rng(1).normal(0.0, 1e-4, 8000) - 0.005 * np.exp(-t / 40.0)
    term = characterise_noise(t, samples, "gz").terms["N"]
    assert term.value is None and term.limit > 1e-4 * DT**0.5
