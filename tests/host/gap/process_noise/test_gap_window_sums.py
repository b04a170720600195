"""Winsorised residuals: no single sample dominates a sum."""

import numpy as np

from hubodo.gap.process_noise.window_sums import winsorise


def test_an_outlier_is_limited_to_six_sigma_and_other_residuals_are_unchanged():
    z = np.clip(np.random.default_rng(2).standard_normal((6, 500)), -5.0, 5.0)
    with_outlier = z.copy()
    with_outlier[2, 17] = 400.0
    limited = winsorise(with_outlier)
    neighbours = np.median(with_outlier[2, 15:20])
    assert limited[2, 17] == neighbours + 6.0
    with_outlier[2, 17] = limited[2, 17]
    np.testing.assert_array_equal(limited, with_outlier)


def test_a_misfit_that_lasts_for_a_turn_is_unchanged_and_an_outlier_in_it_is_limited():
    """A late gyro misses its prediction by many sigma as long as a turn lasts."""
    z = np.random.default_rng(4).standard_normal((1, 500))
    z[0, 200:230] += 40.0
    np.testing.assert_array_equal(winsorise(z), z)
    with_outlier = z.copy()
    with_outlier[0, 215] += 300.0
    limited = winsorise(with_outlier)
    assert 40.0 < limited[0, 215] < 55.0
    with_outlier[0, 215] = limited[0, 215]
    np.testing.assert_array_equal(limited, with_outlier)


def test_residuals_that_are_all_large_are_unchanged():
    z = 50.0 + np.random.default_rng(3).standard_normal((1, 500))
    np.testing.assert_array_equal(winsorise(z), z)
