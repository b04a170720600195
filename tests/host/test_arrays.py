"""Sine and cosine of arrays of angles, and runs of flags."""

import numpy as np

from hubodo.arrays import find_runs, sin_cos


def test_sine_and_cosine_agree_with_those_of_numpy():
    rng = np.random.default_rng(1)
    quarter_turns = 0.5 * np.pi * np.arange(-8, 9)
    for angle in (quarter_turns, *(rng.uniform(-limit, limit, 2000) for limit in (1e-6, 1.0, 1e3, 1e5))):
        sine, cosine = sin_cos(angle)
        np.testing.assert_allclose(sine, np.sin(angle), rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(cosine, np.cos(angle), rtol=0.0, atol=1e-15)


def test_runs_are_index_ranges_of_consecutive_flags():
    assert find_runs(np.array([1, 1, 0, 1, 0, 0, 1], bool)) == [(0, 2), (3, 4), (6, 7)]
    assert find_runs(np.zeros(3, bool)) == find_runs(np.zeros(0, bool)) == []
