"""Jackknife surprise: Hotelling's test of group means, valid in correlated noise, needs several groups."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import f as fisher
from scipy.stats import norm, ttest_1samp

from hubodo.gap.refit.cross_validation import FoldGrams
from hubodo.gap.refit.jackknife import apply_jackknife, compute_jackknife_covariance
from hubodo.gap.refit.prior import CoordinatePrior

N_GROUPS, GROUP_SIZE = 16, 50


def build_groups(columns, residual):
    """Return the groups of a linear model: columns, (N, k), residual, (N,), in groups of equal size."""
    rows = np.column_stack([columns, residual]).reshape(-1, GROUP_SIZE, columns.shape[1] + 1)
    grams = np.einsum("gni,gnj->gij", rows, rows)
    return FoldGrams(grams, np.sum(columns**2, axis=0), np.full(len(rows), float(GROUP_SIZE)))


def draw_noise(rng):
    """Return correlated noise, (N,), whose size differs from group to group."""
    noise = lfilter([1.0], [1.0, -0.8], rng.standard_normal(N_GROUPS * GROUP_SIZE))
    return noise * np.repeat(rng.uniform(0.5, 2.0, N_GROUPS), GROUP_SIZE)


def jackknife_of(columns, residual, places):
    size = columns.shape[1]
    prior = CoordinatePrior(np.zeros(size), np.zeros(size), 1.0)
    zeros = np.zeros(len(places))
    return apply_jackknife(build_groups(columns, residual), prior, zeros, np.array(places))


def surprise_of(columns, residual, places):
    return jackknife_of(columns, residual, places).surprise


def test_a_constant_has_the_p_value_of_students_test_of_the_group_means():
    residual = 0.1 + np.random.default_rng(3).standard_normal(N_GROUPS * GROUP_SIZE)
    means = residual.reshape(N_GROUPS, -1).mean(axis=1)
    expected = -np.log(ttest_1samp(means, 0.0).pvalue)
    assert surprise_of(np.ones((len(residual), 1)), residual, [0]) == pytest.approx(expected, rel=1e-9)


def test_three_coordinates_have_the_p_value_of_hotellings_test():
    rng = np.random.default_rng(4)
    residual = 0.1 + rng.standard_normal(3 * N_GROUPS * GROUP_SIZE)
    # Each coordinate is the mean of every third sample, and a group contains as many of each.
    columns = np.tile(np.eye(3), (len(residual) // 3, 1))
    size = 3 * GROUP_SIZE
    rows = np.column_stack([columns, residual]).reshape(N_GROUPS, size, 4)
    groups = FoldGrams(
        np.einsum("gni,gnj->gij", rows, rows), np.sum(columns**2, axis=0), np.full(N_GROUPS, size)
    )
    means = residual.reshape(N_GROUPS, GROUP_SIZE, 3).mean(axis=1)
    centre = means.mean(axis=0)
    t2 = N_GROUPS * centre @ np.linalg.inv(np.cov(means.T)) @ centre
    together = -fisher.logsf((N_GROUPS - 3) / (3 * (N_GROUPS - 1)) * t2, 3, N_GROUPS - 3)
    alone = -np.log(ttest_1samp(means, 0.0, axis=0).pvalue)
    expected = max(together, alone.max() - np.log(3.0))
    prior = CoordinatePrior(np.zeros(3), np.zeros(3), 1.0)
    surprise = apply_jackknife(groups, prior, np.zeros(3), np.arange(3)).surprise
    assert surprise == pytest.approx(expected, rel=1e-9)


def test_an_absent_effect_is_surprising_as_often_as_stated_in_correlated_uneven_noise():
    """Five per cent beyond the 5 % point, while a white likelihood exceeds its own in most drives."""
    rng, n = np.random.default_rng(5), N_GROUPS * GROUP_SIZE
    column = np.sin(np.arange(n) * 2.0 * np.pi / 600.0)[:, None]
    surprises, naive = [], 0
    for _ in range(600):
        noise = draw_noise(rng)
        surprises.append(surprise_of(column, noise, [0]))
        step = (column[:, 0] @ noise) / (column[:, 0] @ column[:, 0])
        naive += step**2 * (column[:, 0] @ column[:, 0]) / np.var(noise) > 3.84
    share = np.mean(np.array(surprises) > -np.log(0.05))
    print(f"seed 5: {share:.3f} of 600 beyond the 5 % point, {naive / 600:.2f} by the white likelihood")
    assert 0.025 < share < 0.085 and naive > 200


def test_what_shows_in_three_groups_has_the_p_value_of_students_test_of_their_means():
    residual = 0.5 + np.random.default_rng(9).standard_normal(N_GROUPS * GROUP_SIZE)
    is_shown = np.repeat(np.isin(np.arange(N_GROUPS), [2, 7, 11]), GROUP_SIZE)
    means = residual[is_shown].reshape(3, -1).mean(axis=1)
    expected = -np.log(ttest_1samp(means, 0.0).pvalue)
    assert surprise_of(is_shown[:, None].astype(float), residual, [0]) == pytest.approx(expected, rel=1e-9)


def test_what_one_group_shows_alone_is_no_surprise():
    residual = np.random.default_rng(6).standard_normal(N_GROUPS * GROUP_SIZE)
    is_shown = np.arange(len(residual)) < GROUP_SIZE
    alone = surprise_of(is_shown[:, None].astype(float), residual + 5.0 * is_shown, [0])
    in_all = surprise_of(np.ones((len(residual), 1)), residual + 5.0 / N_GROUPS, [0])
    assert alone < 2.0 < 10.0 < in_all


def test_the_covariance_of_a_constant_is_that_of_the_mean_of_the_groups_by_students_distribution():
    residual = 0.1 + np.random.default_rng(11).standard_normal(N_GROUPS * GROUP_SIZE)
    groups = build_groups(np.ones((len(residual), 1)), residual)
    prior = CoordinatePrior(np.zeros(1), np.zeros(1), 1.0)
    means = residual.reshape(N_GROUPS, -1).mean(axis=1)
    sigma = np.sqrt(compute_jackknife_covariance(groups, prior, np.array([0]))[0, 0])
    one_sigma = ttest_1samp(means, 0.0).confidence_interval(norm.cdf(1.0) - norm.cdf(-1.0))
    assert sigma == pytest.approx(0.5 * (one_sigma.high - one_sigma.low), rel=1e-9)


@pytest.mark.parametrize("seed", (12, 13))
def test_one_sigma_covers_two_thirds_of_the_errors_where_few_groups_show_an_effect(seed):
    """Two sigma of an effect that three groups show would cover 85 % without Student's distribution."""
    rng, n = np.random.default_rng(seed), N_GROUPS * GROUP_SIZE
    prior, errors = CoordinatePrior(np.zeros(1), np.zeros(1), 1.0), []
    for _ in range(600):
        size = (
            np.exp(rng.standard_normal(N_GROUPS)) if seed == 12 else np.isin(np.arange(N_GROUPS), (2, 7, 11))
        )
        column = (np.repeat(size, GROUP_SIZE) * np.sin(np.arange(n) * 2.0 * np.pi / 600.0))[:, None]
        noise = draw_noise(rng)
        groups = build_groups(column, noise)
        sigma = np.sqrt(compute_jackknife_covariance(groups, prior, np.array([0]))[0, 0])
        errors.append(float(column[:, 0] @ noise) / float(column[:, 0] @ column[:, 0]) / sigma)
    covered = [np.mean(np.abs(errors) < k) for k in (1.0, 2.0)]
    print(f"seed {seed}: within 1 and 2 sigma {covered[0]:.2f}, {covered[1]:.2f} of 600")
    assert 0.64 < covered[0] < 0.9 and covered[1] > 0.91


def test_two_groups_agree_if_both_show_the_same_and_one_alone_does_not():
    """They are too few for a surprise."""
    noise = np.random.default_rng(10).standard_normal(N_GROUPS * GROUP_SIZE)
    number = np.arange(len(noise)) // GROUP_SIZE
    is_shown = (number == 3) | (number == 12)
    both = jackknife_of(is_shown[:, None].astype(float), noise + 5.0 * is_shown, [0])
    alone = jackknife_of(is_shown[:, None].astype(float), noise + 5.0 * (number == 3), [0])
    assert both.surprise == 0.0 and both.agreement_sigmas > 10.0
    assert alone.agreement_sigmas < 3.0


def test_of_many_coordinates_one_alone_is_tested_where_groups_are_few():
    rng = np.random.default_rng(7)
    columns, noise = rng.standard_normal((4 * GROUP_SIZE, 3)), rng.standard_normal(4 * GROUP_SIZE)
    assert (
        surprise_of(columns, noise + columns[:, 0], [0, 1, 2])
        > 5.0
        > 2.0
        > surprise_of(columns, noise, [0, 1, 2])
    )


def test_two_groups_give_no_surprise():
    rng = np.random.default_rng(8)
    columns, noise = rng.standard_normal((2 * GROUP_SIZE, 1)), rng.standard_normal(2 * GROUP_SIZE)
    assert surprise_of(columns, noise + columns[:, 0], [0]) == 0.0
