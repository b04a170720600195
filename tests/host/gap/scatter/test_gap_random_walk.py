"""Detection of a random walk, against a multivariate normal density."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from gap_residuals import SEEDS, SIGMA, WINDOW, shown, walking, white
from hubodo.gap.scatter.random_walk import _refine_peak, detect_random_walk


@pytest.mark.parametrize("seed", SEEDS)
def test_one_step_of_the_zero_is_no_random_walk(seed):
    """As large as a walk would be, in all axes at once; the walks of the test below are found."""
    rng = np.random.default_rng(seed)
    clean, y = white(rng, 3000)
    y[:3, 1100:] += np.array([[0.004], [-0.006], [0.003]])
    assert detect_random_walk([shown(y, clean)]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_walk_gains_the_density_of_window_means_with_its_covariance(seed):
    k, of_inputs = (
        0.003,
        1e-5,
    )  # the latter in (rad/s)²: so much of a window's mean may be noise of the inputs
    rng = np.random.default_rng(seed)
    clean, y = walking(rng, k)
    t = shown(y, clean).node.t
    parts = [np.flatnonzero((t >= a) & (t < a + WINDOW)) for a in np.arange(t[0], t[-1], WINDOW)]
    for part in parts:
        y[:3, part] += np.sqrt(of_inputs) * rng.standard_normal((3, 1))
    one = replace(shown(y, clean), input_variance=np.full(6, of_inputs))
    found = detect_random_walk([one])
    assert [it.term.effect.name for it in found] == ["gyro_rate_random_walk"]
    assert abs(found[0].term.effect.k - k) < 4.0 * found[0].sigmas["k"]
    at = np.array([t[part].mean() for part in parts]) - t[parts[0]].mean()
    alone = np.diag([SIGMA[0, 0] ** 2 / len(part) + of_inputs for part in parts])
    means = [[one.value[row, part].mean() for part in parts] for row in range(3)]

    def log_density(k):
        # Means over windows: of two, all that lies before the later one; of one, two thirds of its own part.
        walk = k**2 * (1.5 * WINDOW + np.minimum.outer(at, at) - np.diag(np.full(len(at), WINDOW / 6.0)))
        return sum(multivariate_normal(cov=alone + walk).logpdf(mean) for mean in means)

    # The intensities that are tried: a factor of 1.46 apart.
    gain = max(log_density(k) for k in np.geomspace(1e-6, 3e-2, 28)) - log_density(0.0)
    assert found[0].gain == pytest.approx(gain, rel=1e-6)
    # 1 sigma of ln k from the curvature there.
    top, h = found[0].term.effect.k, np.log(1.46) / 12.0
    bend = (log_density(top * np.exp(h)) - 2.0 * log_density(top) + log_density(top * np.exp(-h))) / h**2
    assert found[0].sigmas["k"] == pytest.approx(top / np.sqrt(-bend), rel=0.25)


def test_a_walk_far_above_the_noise_comes_back_as_large_as_it_is():
    """Windows' means taken for points of the walk would make it a sixth too small, many sigmas."""
    ratios = []
    for seed in range(6):
        clean, y = walking(np.random.default_rng([seed, 3]), 0.02, 12_000)
        (found,) = detect_random_walk([shown(y, clean)])
        ratios.append(found.term.effect.k / 0.02)
    print("seeds [0..5, 3]:", np.round(ratios, 3))
    assert abs(np.mean(ratios) - 1.0) < 3.0 * found.sigmas["k"] / 0.02 / np.sqrt(6)


def test_a_step_of_the_bias_is_no_random_walk():
    clean, y = white(np.random.default_rng(1), 3000)
    y[:3, 1500:] += 0.05
    assert detect_random_walk([shown(y, clean)]) == []


@pytest.mark.parametrize("k", [0.011, 0.03, 0.2])
def test_the_top_of_a_likelihood_between_the_steps_of_its_grid_is_found_with_its_width(k):
    """A Gaussian in ln k of 0.3: its top is at k, and 1 sigma of k is 0.3 k."""
    grid = np.geomspace(0.01, 0.3, 12)
    found, sigma = _refine_peak(-0.5 * (np.log(grid / k) / 0.3) ** 2, grid)
    assert found == pytest.approx(k, rel=1e-9)
    assert sigma == pytest.approx(0.3 * k, rel=1e-9)


def test_a_likelihood_that_still_rises_at_the_end_of_its_grid_says_so():
    """No top, no width: the last step but one, as unsure as it is large."""
    grid = np.geomspace(0.01, 0.3, 12)
    assert _refine_peak(np.exp(grid / 0.3), grid) == (grid[-2], grid[-2])
