"""Detection of repeated samples, against a mixture maximised by scipy and a wheel that stands."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from gap_residuals import SEEDS, SIGMA, build_residual, draw_readings_with_repeats
from hubodo.gap.scatter.repeats import detect_repeats


@pytest.mark.parametrize("coarseness", [0.1, 0.3])
@pytest.mark.parametrize("seed", SEEDS)
def test_the_gain_is_that_of_a_mixture_of_repeats_and_chance(seed, coarseness):
    step = coarseness * SIGMA
    clean, y, is_new = draw_readings_with_repeats(np.random.default_rng(seed), 0.02, step)
    proposals = detect_repeats([build_residual(y, clean, is_new=is_new)])
    # Probability that two Gaussian draws, whose means differ, fall into one step of the lattice.
    at = np.flatnonzero(~is_new)
    source = [max(k for k in range(index) if is_new[k]) for index in at]
    offsets = np.linspace(-0.5, 0.5, 21)[:-1, None]
    edges = coarseness * (np.arange(-250, 251) - offsets)
    change = np.minimum(np.abs(clean[:, at] - clean[:, source]) / SIGMA, 6.0)
    bins = np.diff(norm.cdf(edges))
    same = [np.sum(bins * np.diff(norm.cdf(edges + d)), axis=1).mean() for d in change.ravel()]
    chance = np.prod(np.reshape(same, change.shape), axis=0)
    n_new = int(is_new.sum())

    def gain(p):
        return n_new * np.log1p(-p) + np.sum(np.log((p + (1.0 - p) * chance) / chance))

    best = minimize_scalar(lambda p: -gain(p), bounds=(1e-6, 0.5), method="bounded")
    assert proposals[0].term.effect.probability == pytest.approx(best.x, rel=0.01)
    assert proposals[0].gain == pytest.approx(-best.fun, rel=0.01)


@pytest.mark.parametrize("seed", SEEDS)
def test_readings_that_agree_on_a_standing_wheel_are_no_repeats(seed):
    rng = np.random.default_rng(seed)
    n, step = 4000, 2.5 * SIGMA
    clean = np.zeros((6, n))
    clean[:, n // 2 :] = 30.0 * SIGMA * np.sin(0.2 * np.arange(n // 2) + np.arange(6)[:, None])
    y = step * np.round((clean + SIGMA * rng.standard_normal((6, n))) / step)
    is_equal = np.append(False, (np.diff(y, axis=1) == 0.0).all(axis=0))
    assert is_equal.sum() > 20
    assert detect_repeats([build_residual(y, clean, is_new=~is_equal)]) == []
    for k in range(2100, n, 500):  # as many may hide among those of the standing half
        y[:, k] = y[:, k - 1]
    is_equal = np.append(False, (np.diff(y, axis=1) == 0.0).all(axis=0))
    proposal = detect_repeats([build_residual(y, clean, is_new=~is_equal)])[0]
    print(f"seed {seed}: {is_equal.sum()} equal, {proposal.term.effect.probability * n:.1f} repeats")
    assert 4.0 <= proposal.term.effect.probability * n <= 8.0


@pytest.mark.parametrize("seed", SEEDS)
def test_samples_that_agree_in_pauses_of_a_noisy_drive_are_no_repeats(seed):
    """Noise estimated for pauses and driving together makes agreement in the pauses appear impossible."""
    rng = np.random.default_rng(seed)
    n, step = 6000, 0.5 * SIGMA
    clean, noise = np.zeros((6, n)), SIGMA * rng.standard_normal((6, n))
    for start in range(500, n, 2000):
        noise[:, start : start + 100] *= 0.2
    y = step * np.round((clean + noise) / step)
    is_equal = np.append(False, (np.diff(y, axis=1) == 0.0).all(axis=0))
    print(f"seed {seed}: {is_equal.sum()} samples equal their predecessor")
    assert is_equal.sum() > 10
    assert detect_repeats([build_residual(y, clean, is_new=~is_equal)]) == []
