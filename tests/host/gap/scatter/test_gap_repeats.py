"""Detection of repeated samples, against scipy's Poisson distribution."""

import numpy as np
import pytest
from scipy.stats import norm, poisson

from gap_residuals import SEEDS, SIGMA, repeated, shown
from hubodo.gap.scatter.repeats import detect_repeats


@pytest.mark.parametrize("seed", SEEDS)
def test_repeats_gain_a_poisson_ratio_and_what_the_older_model_explains_of_them(seed):
    step = 0.3 * SIGMA
    clean, y, fresh = repeated(np.random.default_rng(seed), 0.02, step)
    one = shown(y, clean, fresh=fresh)
    found = detect_repeats([one])
    count, seen = y.shape[1], int((~fresh).sum())
    assert found[0].term.effect.probability == pytest.approx(seen / count)
    # Two Gaussian draws in the same step of the lattice, in all six channels.
    edges = step[0, 0] * (np.arange(-80, 81) - 0.5)
    same = float(np.sum(np.diff(norm.cdf(edges, scale=SIGMA[0, 0])) ** 2))
    by_chance = max(count * same**6, 1e-3)
    ratio = poisson.logpmf(seen, seen) - poisson.logpmf(seen, by_chance)
    older = 0.0
    for at in np.flatnonzero(~fresh):
        source = at
        while not fresh[source]:
            source -= 1
        now, then = ((one.value[:, k] / SIGMA[:, 0]).clip(-6.0, 6.0) for k in (at, source))
        older += float(np.sum(norm.logpdf(then) - norm.logpdf(now)))
    assert found[0].gain == pytest.approx(ratio + older, rel=2e-3)
