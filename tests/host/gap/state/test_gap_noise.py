"""Estimation of channel noise from residuals."""

from types import SimpleNamespace

import numpy as np
import pytest

from gap_residuals import SEEDS, SIGMA, build_residual, draw_readings
from hubodo.gap.state.noise import estimate_channel_noise


@pytest.mark.parametrize("seed", SEEDS)
def test_repeated_readings_are_not_new_and_do_not_bias_the_noise(seed):
    rng = np.random.default_rng(seed)
    clean, y = draw_readings(rng, 4000)
    is_repeated = np.append(False, rng.random(3999) < 0.4)
    for index in np.flatnonzero(is_repeated):
        y[:, index] = y[:, index - 1]
    declared = SimpleNamespace(model=SimpleNamespace(noise=SimpleNamespace(gyro=1e-3, accel=1e-3)))
    noise = estimate_channel_noise(
        declared, build_residual(y, clean).node, SimpleNamespace(rolling=None), y - clean
    )
    assert (noise.is_new == ~is_repeated).all()
    assert noise.sigma.mean(axis=1) == pytest.approx(SIGMA[:, 0], rel=0.1)
