"""Detection of outliers, against explicit mixture likelihoods."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from gap_residuals import SEEDS, SIGMA, build_residual, draw_readings
from hubodo.gap.scatter.outliers import detect_outliers, find_spiky_channels


def subtract_neighbours(residual, row):
    """Return z of a channel minus the median of two neighbours on either side, and its robust sigma."""
    z = residual.value[row] / SIGMA[row]
    padded = np.pad(z, 2, mode="reflect")
    z = z - [np.median(np.delete(padded[k : k + 5], 2)) for k in range(len(z))]
    return z, np.median(np.abs(z)) / norm.ppf(0.75)


@pytest.mark.parametrize("seed", SEEDS)
def test_coarse_quantization_steps_are_not_detected_as_outliers(seed):
    clean, y = draw_readings(np.random.default_rng(seed))
    clean[:2] = 0.0
    step = 3.0 * SIGMA[0, 0]
    y[:2] = SIGMA[0] * np.random.default_rng(seed).standard_normal((2, y.shape[1]))
    y[:3] = step * np.round(y[:3] / step)
    assert detect_outliers([build_residual(y, clean)]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gain_of_outliers_is_the_log_ratio_of_a_mixture_to_a_gaussian(seed):
    rng = np.random.default_rng(seed)
    share, sigma = 0.01, 12.0
    clean, y = draw_readings(rng, 4000)
    is_outlier = rng.random(y.shape) < share
    residual = build_residual(y + is_outlier * sigma * SIGMA * rng.standard_normal(y.shape), clean)
    proposals = detect_outliers([residual])
    assert [it.term.effect.name for it in proposals] == ["outliers"]
    values, sigmas = proposals[0].term.effect.values(), proposals[0].sigmas
    assert abs(values["probability"] - share) < 4.0 * sigmas["probability"] + 0.002
    assert abs(values["sigma"] - sigma) < 4.0 * sigmas["sigma"] + 1.0
    gain = 0.0
    for row in range(6):
        z, one_sigma = subtract_neighbours(residual, row)
        z, wide_sigma = z / one_sigma, np.hypot(1.0, values["sigma"] / one_sigma)
        p = values["probability"]
        mixture = np.log((1.0 - p) * norm.pdf(z) + p * norm.pdf(z, scale=wide_sigma))
        gaussian = max(float(norm.logpdf(z, scale=scale).sum()) for scale in np.linspace(0.9, 1.3, 21))
        gain += float(mixture.sum()) - gaussian
    assert proposals[0].gain == pytest.approx(gain, rel=0.02)


def draw_road_noise(rng):
    """Return a residual of noise between a fifth and twice the declared one, and a tail within each level."""
    clean, _ = draw_readings(rng, 6000)
    group = np.arange(6000) // 200 % 6
    levels = np.geomspace(0.2, 2.0, 6)
    spread = np.exp(0.4 * rng.standard_normal(6000))
    y = clean + SIGMA * levels[group] * spread * rng.standard_normal(clean.shape)
    noise = {"group_sigmas": SIGMA * levels, "group_indices": group.astype(np.uint8)}
    return clean, y, noise


@pytest.mark.parametrize("share, sigma", [(0.01, 15.0), (0.005, 30.0)])
@pytest.mark.parametrize("seed", SEEDS)
def test_outliers_have_one_size_on_a_road_whose_noise_varies(seed, share, sigma):
    rng = np.random.default_rng(seed)
    clean, y, noise = draw_road_noise(rng)
    y += (rng.random(y.shape) < share) * sigma * SIGMA * rng.standard_normal(y.shape)
    residual = build_residual(y, clean)
    (proposal,) = detect_outliers([replace(residual, noise=replace(residual.noise, **noise))])
    values = proposal.term.effect.values()
    assert values["probability"] == pytest.approx(share, rel=0.2)
    assert values["sigma"] == pytest.approx(sigma, rel=0.15)


@pytest.mark.parametrize("seed", SEEDS)
def test_bumps_below_the_declared_noise_are_no_bursts_of_outliers(seed):
    """A sensor that is quiet at standstill, where bumps of half the declared noise last for four readings."""
    rng = np.random.default_rng(seed)
    clean, _ = draw_readings(rng, 6000)
    group = np.arange(6000) // 600 % 2
    levels = np.array([0.07, 1.0])
    y = clean + SIGMA * levels[group] * rng.standard_normal(clean.shape)
    for start in rng.choice(np.flatnonzero(group[:-4] == 0), 10, replace=False):
        y[:, start : start + 4] += 0.5 * SIGMA * rng.standard_normal((6, 1)) * [1.0, -1.0, 1.0, -1.0]
    y += (rng.random(y.shape) < 0.01) * 15.0 * SIGMA * rng.standard_normal(y.shape)
    residual = build_residual(y, clean)
    noise = replace(residual.noise, group_sigmas=SIGMA * levels, group_indices=group.astype(np.uint8))
    (proposal,) = detect_outliers([replace(residual, noise=noise)])
    values = proposal.term.effect.values()
    assert values["probability"] == pytest.approx(0.01, rel=0.3)
    assert values["sigma"] == pytest.approx(15.0, rel=0.2)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_tail_of_noise_that_varies_is_no_outlier(seed):
    clean, y, noise = draw_road_noise(np.random.default_rng(seed))
    residual = build_residual(y, clean)
    assert detect_outliers([replace(residual, noise=replace(residual.noise, **noise))]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_a_single_outlier_leaves_probability_and_sigma_uncertain(seed):
    """Given one count, 1 sigma of a Poisson rate is the rate, that of a Gaussian sigma is sigma / sqrt(2).

    The tolerance follows from the grid of rates, whose steps are a factor of 1.3.
    """
    clean, y = draw_readings(np.random.default_rng(seed), 400)
    y[4, 250] += 30.0 * SIGMA[4, 0]
    (proposal,) = detect_outliers([build_residual(y, clean)])
    values = proposal.term.effect.values()
    assert proposal.sigmas["probability"] == pytest.approx(values["probability"], rel=0.14)
    assert proposal.sigmas["sigma"] == pytest.approx(values["sigma"] / np.sqrt(2.0), rel=0.14)
    assert "about 1 isolated" in proposal.where


def test_spikes_of_one_channel_and_bursts_are_not_detected_as_outliers():
    rng = np.random.default_rng(1)
    clean, y = draw_readings(rng, 4000)
    is_outlier = rng.random(4000) < 0.01
    spiky = y.copy()
    spiky[4] += 12.0 * SIGMA[4] * is_outlier * rng.standard_normal(4000)
    residual = build_residual(spiky, clean)
    assert detect_outliers([residual]) == []
    assert [row for row, _, _ in find_spiky_channels(residual)] == [4]
    bursts = y.copy()
    for index in np.flatnonzero(is_outlier[:-4]):
        bursts[:, index : index + 4] += 12.0 * SIGMA * rng.standard_normal((6, 1)) * [1.0, -1.0, 1.0, -1.0]
    assert detect_outliers([build_residual(bursts, clean)]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_spikes_are_detected_relative_to_the_local_scatter_not_the_estimated_noise(seed):
    rng = np.random.default_rng(seed)
    clean, y = draw_readings(rng)
    y[2, 30::60] += 20.0 * SIGMA[2]
    residual = build_residual(y, clean)
    with_larger_noise = replace(residual, noise=replace(residual.noise, group_sigmas=3.0 * SIGMA))
    ((row, count, size),) = find_spiky_channels(residual)
    assert (row, count) == (2, 25)
    # The median of four neighbours has a variance of 0.3.
    assert size == pytest.approx(20.0 / np.sqrt(1.3), rel=0.1)
    assert find_spiky_channels(with_larger_noise) == [(row, count, pytest.approx(size))]


def test_stated_errors_of_share_and_size_are_those_of_many_drives():
    share, sigma, pulls = 0.004, 8.0, []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        clean, y = draw_readings(rng, 3000)
        hits = rng.random(y.shape) < share
        y += hits * sigma * SIGMA * rng.standard_normal(y.shape)
        (proposal,) = detect_outliers([build_residual(y, clean)])
        values = proposal.term.effect.values()
        pulls.append(
            [
                (values["probability"] - share) / proposal.sigmas["probability"],
                (values["sigma"] - sigma) / proposal.sigmas["sigma"],
            ]
        )
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    print(f"seeds 0 to 23: rms of error over sigma {rms[0]:.2f} of the share, {rms[1]:.2f} of the size")
    assert np.all((rms > 0.7) & (rms < 1.4))


@pytest.mark.parametrize("seed", SEEDS)
def test_outliers_of_one_size_are_detected_where_channels_are_quieter_than_declared(seed):
    """A gyro with a third of the declared noise shows more of the outliers of three declared sigmas."""
    rng = np.random.default_rng(seed)
    clean, y = draw_readings(rng, 6000)
    y = clean + np.array([0.3, 0.3, 1.0, 0.7, 0.7, 0.7])[:, None] * (y - clean)
    y += (rng.random(y.shape) < 0.02) * 3.2 * SIGMA * rng.standard_normal(y.shape)
    (proposal,) = detect_outliers([build_residual(y, clean)])
    assert proposal.term.effect.values()["sigma"] == pytest.approx(3.2, rel=0.25)


@pytest.mark.parametrize("seed", SEEDS)
def test_bursts_of_a_road_hide_no_outliers(seed):
    """Thirty bumps of six readings in all channels, beside 0.3 % of outliers in noise that varies."""
    rng = np.random.default_rng(seed)
    share, sigma = 0.003, 12.0
    clean, y, noise = draw_road_noise(rng)
    for start in rng.integers(0, 5990, 30):
        y[:, start : start + 6] += 10.0 * SIGMA * rng.standard_normal((6, 6))
    y += (rng.random(y.shape) < share) * sigma * SIGMA * rng.standard_normal(y.shape)
    residual = build_residual(y, clean)
    (proposal,) = detect_outliers([replace(residual, noise=replace(residual.noise, **noise))])
    values, sigmas = proposal.term.effect.values(), proposal.sigmas
    print(f"seed {seed}: share {values['probability']:.4f}, size {values['sigma']:.1f}")
    assert abs(values["probability"] - share) < 3.5 * sigmas["probability"]
    assert abs(values["sigma"] - sigma) < 3.5 * sigmas["sigma"]


@pytest.mark.parametrize(("share", "size"), [(0.018, 3.5), (0.005, 5.0)])
def test_share_and_size_of_outliers_are_unbiased(share, size):
    """They enlarge the median of the noise by 1 %, which would hide a sixth of them."""
    ratios = []
    for seed in range(8):
        rng = np.random.default_rng([seed, 7])
        clean, y = draw_readings(rng, 6000)
        is_hit = rng.random(y.shape) < share
        y += is_hit * SIGMA * size * rng.standard_normal(y.shape)
        (proposal,) = detect_outliers([build_residual(y, clean)])
        effect = proposal.term.effect
        ratios.append((effect.probability / is_hit.mean(), effect.sigma / size))
    mean, error = np.mean(ratios, axis=0), np.std(ratios, axis=0) / np.sqrt(len(ratios))
    print(f"seeds [0..7, 7]: share {mean[0]:.3f} ± {error[0]:.3f}, size {mean[1]:.3f} ± {error[1]:.3f}")
    assert np.all(np.abs(mean - 1.0) < np.maximum(3.0 * error, 0.05))
