"""By how much the scatter of blocks of windows tempers a gain: not for what so few scatter by chance."""

from types import SimpleNamespace

import numpy as np

from hubodo.gap.refit.refit import Refit


def tempering(score):
    """Of a fit of one coordinate with unit information in all."""
    return Refit.tempering.fget(SimpleNamespace(covariance=np.eye(1), score=score))


def test_independent_blocks_hardly_temper_a_gain_and_alike_ones_do():
    rng = np.random.default_rng(1)
    alone = [tempering(rng.standard_normal((15, 1)) / np.sqrt(15.0)) for _ in range(400)]
    beyond = float(np.mean(np.array(alone) > 1.0))
    print(f"seed 1, 400 fits of 15 blocks: mean {np.mean(alone):.3f}, above 1 in {beyond:.2f}")
    assert np.mean(alone) < 1.1
    assert 0.05 < beyond < 0.3
    together = [tempering(3.0 * rng.standard_normal((60, 1)) / np.sqrt(60.0)) for _ in range(400)]
    assert 6.0 < np.median(together) < 9.5
