"""Detection of outliers, against sums over mixtures written out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from gap_residuals import SEEDS, SIGMA, shown, white
from hubodo.gap.scatter.outliers import detect_outliers, find_spiky_channels


def beside_neighbours(residual, row):
    """z of a channel less the median of two neighbours on either side, and its robust sigma."""
    z = residual.value[row] / SIGMA[row]
    around = np.pad(z, 2, mode="reflect")
    z = z - [np.median(np.delete(around[k : k + 5], 2)) for k in range(len(z))]
    return z, np.median(np.abs(z)) / norm.ppf(0.75)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_step_of_a_coarse_lattice_is_no_wild_reading(seed):
    clean, y = white(np.random.default_rng(seed))
    clean[:2] = 0.0
    step = 3.0 * SIGMA[0, 0]
    y[:2] = SIGMA[0] * np.random.default_rng(seed).standard_normal((2, y.shape[1]))
    y[:3] = step * np.round(y[:3] / step)
    assert detect_outliers([shown(y, clean)]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_outliers_gain_the_mixture_over_the_noise_alone_and_are_counted(seed):
    rng = np.random.default_rng(seed)
    share, sigma = 0.01, 12.0
    clean, y = white(rng, 4000)
    hit = rng.random(y.shape) < share
    one = shown(y + hit * sigma * SIGMA * rng.standard_normal(y.shape), clean)
    found = detect_outliers([one])
    assert [it.term.effect.name for it in found] == ["outliers"]
    values, sigmas = found[0].term.effect.values(), found[0].sigmas
    assert abs(values["probability"] - share) < 4.0 * sigmas["probability"] + 0.002
    assert abs(values["sigma"] - sigma) < 4.0 * sigmas["sigma"] + 1.0
    gain = 0.0
    for row in range(6):
        z, one_sigma = beside_neighbours(one, row)
        z, wide = z / one_sigma, np.hypot(1.0, values["sigma"] / one_sigma)
        p = values["probability"]
        mixed = np.log((1.0 - p) * norm.pdf(z) + p * norm.pdf(z, scale=wide))
        alone = max(float(norm.logpdf(z, scale=scale).sum()) for scale in np.linspace(0.9, 1.3, 21))
        gain += float(mixed.sum()) - alone
    assert found[0].gain == pytest.approx(gain, rel=0.02)


@pytest.mark.parametrize("seed", SEEDS)
def test_of_one_wild_reading_nobody_knows_how_often_it_comes_or_how_wide_they_are(seed):
    """A count of one: 1 sigma of a Poisson rate is the rate, of a Gaussian's sigma 1 / sqrt 2 of it.

    The rates that are tried are a factor of 1.3 apart, of which the count has the root.
    """
    clean, y = white(np.random.default_rng(seed), 400)
    y[4, 250] += 30.0 * SIGMA[4, 0]
    (found,) = detect_outliers([shown(y, clean)])
    values = found.term.effect.values()
    assert found.sigmas["probability"] == pytest.approx(values["probability"], rel=0.14)
    assert found.sigmas["sigma"] == pytest.approx(values["sigma"] / np.sqrt(2.0), rel=0.14)
    assert "about 1 isolated" in found.where


def test_wild_readings_of_one_channel_or_side_by_side_are_no_outliers():
    rng = np.random.default_rng(1)
    clean, y = white(rng, 4000)
    hit = rng.random(4000) < 0.01
    spiky = y.copy()
    spiky[4] += 12.0 * SIGMA[4] * hit * rng.standard_normal(4000)
    one = shown(spiky, clean)
    assert detect_outliers([one]) == []
    assert [row for row, _, _ in find_spiky_channels(one)] == [4]
    bursts = y.copy()
    for at in np.flatnonzero(hit[:-4]):
        bursts[:, at : at + 4] += 12.0 * SIGMA * rng.standard_normal((6, 1)) * [1.0, -1.0, 1.0, -1.0]
    assert detect_outliers([shown(bursts, clean)]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_wild_readings_are_judged_by_the_scatter_around_them_whatever_noise_was_found(seed):
    rng = np.random.default_rng(seed)
    clean, y = white(rng)
    y[2, 30::60] += 20.0 * SIGMA[2]
    one = shown(y, clean)
    wide = replace(one, noise=replace(one.noise, group_sigmas=3.0 * SIGMA))
    ((row, count, size),) = find_spiky_channels(one)
    assert (row, count) == (2, 25)
    # Beside the middle of four neighbours, whose own variance is 0.3.
    assert size == pytest.approx(20.0 / np.sqrt(1.3), rel=0.1)
    assert find_spiky_channels(wide) == [(row, count, pytest.approx(size))]
