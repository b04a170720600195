"""Rounding removed from residuals."""

import numpy as np
import pytest
from scipy.stats import kstest

from gap_residuals import SEEDS, SIGMA, build_residual, draw_readings
from hubodo.gap.scatter.base import remove_rounding


@pytest.mark.parametrize("seed", SEEDS)
def test_residuals_without_rounding_are_gaussian(seed):
    clean, y = draw_readings(np.random.default_rng(seed))
    y[2] = 0.04 * np.round(y[2] / 0.04)
    z = remove_rounding(build_residual(y, clean), 2) / SIGMA[0]
    print(f"seed {seed}: {np.std(z):.3f}, kurtosis {np.mean(z**4) / np.mean(z**2) ** 2:.2f}")
    assert kstest(z, "norm").pvalue > 0.01
