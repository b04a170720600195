"""Residuals are limited so that no single sample dominates."""

import numpy as np

from hubodo.gap.process_noise.window_sums import winsorise


def test_usual_residuals_stay_and_a_wild_one_is_pulled_in_to_six_sigma():
    z = np.clip(np.random.default_rng(2).standard_normal((6, 500)), -5.0, 5.0)
    wild = z.copy()
    wild[2, 17] = 400.0
    limited = winsorise(wild)
    assert limited[2, 17] == 6.0
    wild[2, 17] = limited[2, 17]
    np.testing.assert_array_equal(limited, wild)


def test_where_all_residuals_are_large_they_stay():
    z = 50.0 + np.random.default_rng(3).standard_normal((1, 500))
    np.testing.assert_array_equal(winsorise(z), z)
