"""Detection of repeated samples, against scipy's Poisson distribution."""

import numpy as np
import pytest
from scipy.stats import norm, poisson

from gap_residuals import SEEDS, SIGMA, build_residual, draw_readings_with_repeats
from hubodo.gap.scatter.repeats import detect_repeats


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gain_of_repeats_is_a_poisson_ratio_plus_the_better_fit_of_stale_predictions(seed):
    step = 0.3 * SIGMA
    clean, y, is_new = draw_readings_with_repeats(np.random.default_rng(seed), 0.02, step)
    residual = build_residual(y, clean, is_new=is_new)
    proposals = detect_repeats([residual])
    count, n_repeats = y.shape[1], int((~is_new).sum())
    assert proposals[0].term.effect.probability == pytest.approx(n_repeats / count)
    # Probability that two Gaussian draws fall into the same lattice step, in all six channels.
    edges = step[0, 0] * (np.arange(-80, 81) - 0.5)
    p_same_step = float(np.sum(np.diff(norm.cdf(edges, scale=SIGMA[0, 0])) ** 2))
    expected_by_chance = max(count * p_same_step**6, 1e-3)
    ratio = poisson.logpmf(n_repeats, n_repeats) - poisson.logpmf(n_repeats, expected_by_chance)
    gain_of_stale_model = 0.0
    for index in np.flatnonzero(~is_new):
        source = index
        while not is_new[source]:
            source -= 1
        own, stale = ((residual.value[:, k] / SIGMA[:, 0]).clip(-6.0, 6.0) for k in (index, source))
        gain_of_stale_model += float(np.sum(norm.logpdf(stale) - norm.logpdf(own)))
    assert proposals[0].gain == pytest.approx(ratio + gain_of_stale_model, rel=2e-3)
