"""Detection of a random walk, against a multivariate normal density."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from gap_residuals import (
    RATE_HZ,
    SEEDS,
    SIGMA,
    WINDOW,
    build_residual,
    draw_readings,
    draw_readings_with_walk,
)
from hubodo.gap.process_noise.wheel_phase import window_boundaries
from hubodo.gap.scatter.random_walk import _refine_peak, detect_random_walk


@pytest.mark.parametrize("seed", SEEDS)
def test_a_small_bias_step_is_not_detected_as_a_random_walk(seed):
    """The step is as large as a detectable walk and occurs in all axes at once."""
    rng = np.random.default_rng(seed)
    clean, y = draw_readings(rng, 3000)
    y[:3, 1100:] += np.array([[0.004], [-0.006], [0.003]])
    assert detect_random_walk([build_residual(y, clean)]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gain_of_a_random_walk_is_the_log_density_ratio_of_window_means(seed):
    k = 0.003  # rad/s/√s
    input_variance = 1e-5  # (rad/s)²; variance of a window mean by noise of the inputs
    rng = np.random.default_rng(seed)
    clean, y = draw_readings_with_walk(rng, k)
    t = build_residual(y, clean).node.t
    windows = [np.flatnonzero((t >= a) & (t < a + WINDOW)) for a in np.arange(t[0], t[-1], WINDOW)]
    for window in windows:
        y[:3, window] += np.sqrt(input_variance) * rng.standard_normal((3, 1))
    residual = replace(build_residual(y, clean), input_variance=np.full(6, input_variance))
    proposals = detect_random_walk([residual])
    assert [it.term.effect.name for it in proposals] == ["gyro_rate_random_walk"]
    assert abs(proposals[0].term.effect.k - k) < 4.0 * proposals[0].sigmas["k"]
    times = np.array([t[window].mean() for window in windows]) - t[windows[0]].mean()
    covariance_without_walk = np.diag([SIGMA[0, 0] ** 2 / len(window) + input_variance for window in windows])
    means = [[residual.value[row, window].mean() for window in windows] for row in range(3)]

    def log_density(k):
        # Two different windows share the walk up to the earlier one; the mean of one has W/6 less variance.
        walk = k**2 * (
            1.5 * WINDOW + np.minimum.outer(times, times) - np.diag(np.full(len(times), WINDOW / 6.0))
        )
        return sum(multivariate_normal(cov=covariance_without_walk + walk).logpdf(mean) for mean in means)

    # The grid of the detector: steps by a factor of 1.46 in 12 parts.
    grid = np.geomspace(1e-6, 3e-2, 28)
    coarse = grid[np.argmax([log_density(k) for k in grid])]
    fine = coarse * np.exp(np.linspace(-1.0, 1.0, 25) * np.log(grid[1] / grid[0]))
    gain = max(log_density(k) for k in fine) - log_density(0.0)
    assert proposals[0].gain == pytest.approx(gain, rel=1e-6)
    # 1 sigma of ln k from the curvature at the maximum.
    estimate, step = proposals[0].term.effect.k, np.log(1.46) / 12.0
    curvature = (
        log_density(estimate * np.exp(step))
        - 2.0 * log_density(estimate)
        + log_density(estimate * np.exp(-step))
    ) / step**2
    assert proposals[0].sigmas["k"] == pytest.approx(estimate / np.sqrt(-curvature), rel=0.25)


def test_the_intensity_of_a_strong_walk_is_unbiased():
    """Window means treated as points of the walk would underestimate it by a sixth, many sigmas."""
    ratios = []
    for seed in range(6):
        clean, y = draw_readings_with_walk(np.random.default_rng([seed, 3]), 0.02, 12_000)
        (proposal,) = detect_random_walk([build_residual(y, clean)])
        ratios.append(proposal.term.effect.k / 0.02)
    print("seeds [0..5, 3]:", np.round(ratios, 3))
    assert abs(np.mean(ratios) - 1.0) < 3.0 * proposal.sigmas["k"] / 0.02 / np.sqrt(6)


def test_a_large_bias_step_is_not_detected_as_a_random_walk():
    clean, y = draw_readings(np.random.default_rng(1), 3000)
    y[:3, 1500:] += 0.05
    assert detect_random_walk([build_residual(y, clean)]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_bumps_of_a_road_hide_no_walk(seed):
    """Eight of 487 windows have a mean of many sigmas, beside a walk of one sigma of the mean per window."""
    rng = np.random.default_rng(seed)
    clean, y = draw_readings_with_walk(rng, 0.003, 12_000)
    residual = build_residual(y, clean)
    for window in rng.choice(len(window_boundaries(residual.node.t)) - 2, 8, replace=False):
        start = window_boundaries(residual.node.t)[window]
        y[:3, start : start + 20] += 0.05 * rng.choice([-1.0, 1.0], (3, 1))
    (proposal,) = detect_random_walk([build_residual(y, clean)])
    print(f"seed {seed}: k {proposal.term.effect.k:.5f} ± {proposal.sigmas['k']:.5f}, injected 0.003")
    assert abs(proposal.term.effect.k - 0.003) < 3.5 * proposal.sigmas["k"]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("correlation_time", [0.5, 1.0, 2.0])
def test_slow_noise_that_returns_to_zero_is_no_walk(correlation_time, seed):
    rng = np.random.default_rng(seed)
    clean, y = draw_readings(rng, 12_000)
    period = np.mean(np.diff(build_residual(y, clean).node.t))
    decay = float(np.exp(-period / correlation_time))
    steps = 0.006 * np.sqrt(1.0 - decay**2) * rng.standard_normal((3, 12_000))
    y[:3] += lfilter([1.0], [1.0, -decay], steps)
    assert detect_random_walk([build_residual(y, clean)]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_a_walk_of_one_axis_alone_is_none_of_the_gyros(seed):
    rng = np.random.default_rng(seed)
    clean, y = draw_readings_with_walk(rng, 0.003, 6000)
    y[:2] = clean[:2] + SIGMA[:2] * rng.standard_normal((2, 6000))
    assert detect_random_walk([build_residual(y, clean)]) == []


@pytest.mark.parametrize("k", [0.011, 0.03, 0.2])
def test_the_peak_between_grid_points_is_found_with_its_sigma(k):
    """The likelihood is a Gaussian in ln k with sigma 0.3: its peak is at k, and 1 sigma of k is 0.3 k."""
    grid = np.geomspace(0.01, 0.3, 12)
    peak, sigma = _refine_peak(-0.5 * (np.log(grid / k) / 0.3) ** 2, grid)
    assert peak == pytest.approx(k, rel=1e-9)
    assert sigma == pytest.approx(0.3 * k, rel=1e-9)


def test_a_likelihood_without_a_peak_has_a_sigma_of_100_percent():
    """A likelihood that rises to the end of the grid yields the last but one, and sigma equal to it."""
    grid = np.geomspace(0.01, 0.3, 12)
    assert _refine_peak(np.exp(grid / 0.3), grid) == (grid[-2], grid[-2])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_drift_that_settles_is_not_detected_as_a_random_walk(seed):
    """A walk follows a warm-up by as many nats as noise; an exponential leaves white noise."""
    clean, y = draw_readings(np.random.default_rng(seed), 3000)
    t = np.arange(y.shape[1]) / RATE_HZ
    y[:3] += np.array([[0.006], [-0.004], [0.003]]) * (1.0 - np.exp(-t / 20.0))
    assert detect_random_walk([build_residual(y, clean)]) == []


def test_a_random_walk_is_detected_beside_a_drift_that_settles_in_most_logs():
    n_detected = 0
    for seed in range(12):
        clean, y = draw_readings_with_walk(np.random.default_rng([seed, 5]), 0.002)
        t = np.arange(y.shape[1]) / RATE_HZ
        y[:3] += np.array([[0.003], [-0.002], [0.0015]]) * (1.0 - np.exp(-t / 20.0))
        n_detected += len(detect_random_walk([build_residual(y, clean)]))
    print(f"seeds [0..11, 5]: {n_detected} of 12")
    assert n_detected >= 11
