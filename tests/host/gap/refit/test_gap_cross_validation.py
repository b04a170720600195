"""Cross-validation against least squares on the other folds, and the prior against ridge regression."""

import numpy as np
import pytest

from hubodo.gap.linear.linearisation import invert_information
from hubodo.gap.refit.cross_validation import FoldDeviances, FoldGrams, compute_held_out_gain
from hubodo.gap.refit.prior import CoordinatePrior

N_BLOCKS, SAMPLES, N_COLUMNS = 24, 50, 3
FREE = CoordinatePrior(np.zeros(N_COLUMNS), np.zeros(N_COLUMNS), 1.0)


def draw_blocks(seed, effect, level=lambda block: 1.0):
    """Return rows of each block, (B, n, P+1): columns, and `effect` times the first one in noise."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((N_BLOCKS, SAMPLES, N_COLUMNS + 1))
    rows[:, :, -1] *= np.array([level(block) for block in range(N_BLOCKS)])[:, None]
    rows[:, :, -1] += effect * rows[:, :, 0]
    return rows


def validate(rows, columns, prior=FREE):
    chosen = rows[:, :, [*columns, -1]]
    grams = np.einsum("bni,bnj->bij", chosen, chosen)
    selected = CoordinatePrior(prior.information[list(columns)], prior.value[list(columns)], 1.0)
    squares = np.einsum("bii->i", grams)[:-1]
    return FoldGrams.of_blocks(grams, squares, np.full(len(rows), float(SAMPLES))).cross_validate(selected)


@pytest.mark.parametrize("seed", (1, 2))
def test_each_fold_is_judged_by_least_squares_on_the_others(seed):
    rows = draw_blocks(seed, 0.3)
    folds = np.array_split(rows, len(validate(rows, (0, 1, 2)).held_out))
    for k, fold in enumerate(folds):
        training = np.concatenate([one.reshape(-1, N_COLUMNS + 1) for j, one in enumerate(folds) if j != k])
        step = np.linalg.lstsq(training[:, :-1], training[:, -1], rcond=None)[0]
        test = fold.reshape(-1, N_COLUMNS + 1)
        expected = np.sum((test[:, -1] - test[:, :-1] @ step) ** 2)
        assert validate(rows, (0, 1, 2)).held_out[k] == pytest.approx(expected, rel=1e-9)


def test_an_effect_gains_on_held_out_folds_and_a_superfluous_column_loses():
    gains = []
    for seed in range(40):
        rows = draw_blocks(seed, 0.15)
        nothing, own, more = (validate(rows, columns) for columns in ((), (0,), (0, 1, 2)))
        assert compute_held_out_gain(nothing, own).z > 2.5
        gains.append(compute_held_out_gain(own, more).total)
    print(f"seeds 0 to 39: superfluous columns gain {np.mean(gains):.2f} nats on held-out folds")
    assert np.mean(gains) < -0.3


def test_the_level_of_the_noise_is_in_doubt_only_if_it_differs_from_fold_to_fold():
    even = [validate(draw_blocks(seed, 0.0), (0,)).level_scatter for seed in range(40)]
    uneven = [
        validate(draw_blocks(seed, 0.0, lambda block: 1.0 + (block // 6) % 2), (0,)).level_scatter
        for seed in range(40)
    ]
    assert np.median(even) == 0.0
    # Folds of 150 samples have a deviance of 150 or 600: 1 sigma of 225 √8 folds for the total.
    assert np.median(uneven) == pytest.approx(225.0 * np.sqrt(8.0) * np.sqrt(8.0 / 7.0), rel=0.15)


def test_no_fold_counts_more_than_twice_its_own_gain():
    before = FoldDeviances(np.array([1e6, 30.0]), np.array([20.0, 20.0]), np.full(2, 20.0))
    after = FoldDeviances(np.array([10.0, 10.0]), np.array([10.0, 10.0]), np.full(2, 20.0))
    assert compute_held_out_gain(before, after).total == pytest.approx(10.0 + 10.0)


def test_the_prior_is_ridge_regression_about_the_absent_effect():
    rng = np.random.default_rng(5)
    x, y, value = rng.standard_normal((30, 3)), rng.standard_normal(30), np.array([0.5, -1.0, 2.0])
    prior = CoordinatePrior(np.array([0.0, 4.0, 9.0]), value, 1.0)
    covariance = invert_information(x.T @ x, np.diag(x.T @ x), prior.information)
    step = covariance @ (x.T @ y - prior.gradient)
    rows = np.vstack([x, np.diag(np.sqrt(prior.information))])
    target = np.concatenate([y, -np.sqrt(prior.information) * value])
    expected = np.linalg.lstsq(rows, target, rcond=None)[0]
    np.testing.assert_allclose(step, expected, atol=1e-10)
    assert prior.penalty(step) == pytest.approx(np.sum((rows @ step - target)[30:] ** 2))
