"""A random walk of the bias between standstills: estimated where they show it, and only there."""

import numpy as np
import pytest

from generators.noise import gyro_noise
from hubodo.effects.warmup import WarmupModel
from hubodo.fuse.heading_filter import BiasNoise
from hubodo.sensors.heading.bias_walk import add_bias_walk
from hubodo.sensors.heading.vertical_axis import VerticalAxis

DEG, STEP = np.pi / 180, 0.1
T = np.arange(0.0, 300.0, STEP)
NOISE_TERMS = (0.045 * DEG, 30 * DEG / 3600)
NOISE = BiasNoise(*NOISE_TERMS)
SPANS = ((0, 300), (1400, 1600), (2700, 3000))


def judge(seed, walk=0.0, temperature=None, coefficient=0.0, noise=NOISE):
    """Return K of the result and its remarks; coefficient: deg/s per °C."""
    rng = np.random.default_rng(seed)
    rate = 0.3 * DEG + gyro_noise(len(T), STEP, rng, n=0.045 * DEG, b=20 * DEG / 3600, k=walk)
    if temperature is not None:
        rate = rate + coefficient * DEG * (temperature - temperature.mean())
    axis = VerticalAxis(T, rate, rate, temperature)
    notes = []
    return add_bias_walk(noise, WarmupModel(0.0), axis, SPANS, 0.0, notes).rate_random_walk, notes


def test_flicker_within_its_limit_is_no_walk_and_the_assumption_is_stated():
    results = [judge(seed) for seed in range(40)]
    assert sum(walk > 0.0 for walk, _ in results) <= 1
    # 0.02 deg/s for the 110 s between the standstills at 30 and 140 s, and at 160 and 270 s.
    assert results[0][0] == 0.0 and "turns the heading by 2.2 degrees" in results[0][1][0]


@pytest.mark.parametrize("deg", [0.04, 0.1])
def test_the_size_of_a_walk_is_estimated(deg):
    sizes = np.array([judge(seed, deg * DEG)[0] for seed in range(20)])
    assert np.count_nonzero(sizes) >= 18
    assert 0.6 < np.exp(np.mean(np.log(sizes[sizes > 0.0] / (deg * DEG)))) < 1.6


def test_a_measured_temperature_explains_the_change():
    temperature = 25.0 + 3.0 * np.sin(T / 60.0)
    with_coefficient = BiasNoise(*NOISE_TERMS, warmup={"temperature_coefficient": 0.02 * DEG})
    walk, notes = judge(1, temperature=temperature, coefficient=0.02, noise=with_coefficient)
    assert walk == 0.0 and not notes
    walk, (note,) = judge(1, temperature=temperature, coefficient=0.02)
    assert walk > 0.0 and "sigma includes a random walk of" in note
