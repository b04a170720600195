"""Noise of channels estimated from residuals."""

from types import SimpleNamespace

import numpy as np
import pytest

from gap_residuals import SEEDS, SIGMA, shown, white
from hubodo.gap.state.noise import estimate_channel_noise


@pytest.mark.parametrize("seed", SEEDS)
def test_readings_that_are_sent_again_are_not_fresh_and_the_noise_is_that_of_the_others(seed):
    rng = np.random.default_rng(seed)
    clean, y = white(rng, 4000)
    late = np.append(False, rng.random(3999) < 0.4)
    for at in np.flatnonzero(late):
        y[:, at] = y[:, at - 1]
    declared = SimpleNamespace(model=SimpleNamespace(noise=SimpleNamespace(gyro=1e-3, accel=1e-3)))
    found = estimate_channel_noise(declared, shown(y, clean).node, SimpleNamespace(rolling=None), y - clean)
    assert (found.is_new == ~late).all()
    assert found.sigma.mean(axis=1) == pytest.approx(SIGMA[:, 0], rel=0.1)
