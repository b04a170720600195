"""The likelihood of each effect that shows in scatter, beside scipy's densities and sums written out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest, multivariate_normal, norm, poisson

from hubodo.effects import BY_NAME
from hubodo.gap.explain.unexplained import _list_noise
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.residual import Residual
from hubodo.gap.scatter.base import remove_rounding
from hubodo.gap.scatter.limits import detect_limits
from hubodo.gap.scatter.outliers import detect_outliers, find_spiky_channels
from hubodo.gap.scatter.quantization import detect_quantization, find_lattice_step
from hubodo.gap.scatter.random_walk import _refine_peak, detect_random_walk
from hubodo.gap.scatter.repeats import detect_repeats
from hubodo.gap.state.noise import ChannelNoise, estimate_channel_noise
from hubodo.vehicle import NodeMount

SEEDS = (1, 2)
RATE_HZ, SIGMA = 49.3, np.repeat([0.01, 0.2], 3)[:, None]  # rad/s and m/s²
WINDOW = 0.5  # s


def shown(y, predicted, *, name="left", limits=(np.inf, np.inf), fresh=None, effects=()):
    """What a node with readings y, (6, N), shows beside what was predicted, with noise SIGMA."""
    count = y.shape[1]
    fresh = np.ones(count, bool) if fresh is None else fresh
    t = 0.003 + np.arange(count) / RATE_HZ
    node = NodeData(name, NodeMount("left", "left"), t, y, np.ones(6, bool), limits, None)
    noise, zero = ChannelNoise(SIGMA, np.zeros(count, np.uint8), fresh), np.zeros_like(y)
    present = {BY_NAME[effect]: None for effect in effects}
    return Residual(node, y - predicted, SIGMA, noise, zero, np.zeros(6), present)


def white(rng, count=1500):
    """Wheel-like readings of 30 s, and the same with white noise."""
    t = np.arange(count) / RATE_HZ
    waves = [0.2 * np.cos(5.0 * t), 0.2 * np.sin(5.0 * t), 5.0 + np.sin(0.3 * t)]
    waves += [9.8 * np.cos(5.0 * t), -9.8 * np.sin(5.0 * t), 0.3 * np.sin(0.3 * t)]
    clean = np.stack(waves)
    return clean, clean + SIGMA * rng.standard_normal(clean.shape)


def only(proposals, scope):
    return next(it for it in proposals if it.term.scope == scope)


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_proposed_where_noise_is_all_there_is(seed):
    clean, y = white(np.random.default_rng(seed))
    one = shown(y, clean)
    for look in (
        detect_limits,
        detect_outliers,
        detect_quantization,
        detect_random_walk,
        detect_repeats,
    ):
        assert look([one, replace(one, node=replace(one.node, name="right"))]) == [], look.__name__
    assert find_spiky_channels(one) == []


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "rows", "limit"), [("gyro", (0, 3), 5.5), ("accel", (3, 6), 8.0)])
def test_a_limit_gains_what_clipping_the_model_there_adds_to_the_log_density(seed, name, rows, limit):
    """No sample counts for more than 20 sigma; one that reads nothing at all must not decide."""
    rng = np.random.default_rng(seed)
    clean, y = white(rng)
    part = slice(*rows)
    y[part] = np.clip(y[part], -limit, limit)
    beyond = np.abs(clean[part]) > limit
    assert beyond.sum() > 100
    row, at = np.argwhere(beyond)[0]
    y[rows[0] + row, at] = 0.0
    limits = (limit, np.inf) if name == "gyro" else (np.inf, limit)
    found = detect_limits([shown(y, clean, limits=limits)])
    assert [(it.term.effect.name, it.term.scope) for it in found] == [(f"{name}_saturation", "left")]
    assert found[0].term.effect.limit == limit

    def log_density(mean):
        farthest = norm.logpdf(20.0 * SIGMA[part], scale=SIGMA[part])
        return float(np.sum(np.maximum(norm.logpdf(y[part], mean, SIGMA[part]), farthest)))

    gain = log_density(np.clip(clean[part], -limit, limit)) - log_density(clean[part])
    assert gain > 100.0
    assert found[0].gain == pytest.approx(gain, rel=1e-9)


@pytest.mark.parametrize("step", [0.01, 0.05])
def test_a_limit_is_known_to_half_a_step_of_the_readings(step):
    clean, y = white(np.random.default_rng(1))
    y[:3] = np.clip(step * np.round(y[:3] / step), -5.5, 5.5)
    (found,) = detect_limits([shown(y, clean, limits=(5.5, np.inf))])
    assert found.sigmas["limit"] == pytest.approx(0.5 * step)


def test_limits_of_all_nodes_are_shared_only_where_they_are_one():
    clean, y = white(np.random.default_rng(1))
    made = []
    for name, limit in (("left", 8.0), ("right", 8.0), ("third", 7.0)):
        clipped = np.concatenate([y[:3], np.clip(y[3:], -limit, limit)])
        made.append(shown(clipped, clean, name=name, limits=(np.inf, limit)))
    both = detect_limits(made[:2])
    assert only(both, "all").gain == pytest.approx(only(both, "left").gain + only(both, "right").gain)
    assert [it.term.scope for it in detect_limits(made)] == ["left", "right", "third"]


@pytest.mark.parametrize("seed", SEEDS)
def test_coarse_steps_gain_the_density_with_the_variance_of_rounding_in_it(seed):
    """Wild readings are left to another likelihood."""
    step = 0.04
    clean, y = white(np.random.default_rng(seed))
    y[:3] = step * np.round(y[:3] / step)
    y[0, ::100] += 10.0 * step
    one = shown(y, clean)
    assert find_lattice_step(one) == pytest.approx(step, rel=1e-5)
    found = detect_quantization([one])
    assert [it.term.effect.name for it in found] == ["gyro_quantization"]
    wide = np.sqrt(SIGMA[:3] ** 2 + step**2 / 12.0)
    off = one.value[:3]
    calm = np.abs(off) < 4.0 * wide
    each = norm.logpdf(off, scale=wide) - norm.logpdf(off, scale=SIGMA[:3])
    assert found[0].gain == pytest.approx(float(each[calm].sum()), rel=1e-9)


def test_coarse_steps_get_no_more_credit_than_one_and_a_half_times_what_they_are_worth():
    """Where the noise is larger for other reasons; worth: divergence of the wider density, by quadrature."""
    step = 0.04
    rng = np.random.default_rng(1)
    clean, y = white(rng)
    y[:3] = step * np.round((y[:3] + 0.03 * rng.standard_normal(y[:3].shape)) / step)
    narrow = norm(scale=SIGMA[0, 0])
    wide = norm(scale=np.hypot(SIGMA[0, 0], step / np.sqrt(12.0)))
    worth, _ = quad(lambda x: wide.pdf(x) * (wide.logpdf(x) - narrow.logpdf(x)), -0.2, 0.2)
    found = detect_quantization([shown(y, clean)])
    assert found[0].gain == pytest.approx(1.5 * worth * 3 * y.shape[1], rel=1e-6)


def test_a_lattice_is_seen_in_a_log_in_which_one_axis_hardly_reads_anything_twice():
    step = 0.012
    clean, y = white(np.random.default_rng(1), 400)
    clean[2] += np.linspace(0.0, 60.0, 400)
    y[2] += np.linspace(0.0, 60.0, 400)
    y[:3] = step * np.round(y[:3] / step)
    assert len(np.unique(y[2])) > 350
    assert find_lattice_step(shown(y, clean)) == pytest.approx(step, rel=1e-5)


def test_noise_that_is_far_larger_than_rounding_is_none_of_its_making():
    step = 0.02
    clean, y = white(np.random.default_rng(1))
    y[:3] = step * np.round((y[:3] + 0.06 * np.random.default_rng(2).standard_normal(y[:3].shape)) / step)
    one = shown(y, clean)
    wide = np.concatenate([np.hypot(SIGMA[:3], 0.06), SIGMA[3:]])
    assert detect_quantization([replace(one, noise=replace(one.noise, group_sigmas=wide))]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_a_step_of_a_coarse_lattice_is_no_wild_reading(seed):
    clean, y = white(np.random.default_rng(seed))
    clean[:2] = 0.0
    step = 3.0 * SIGMA[0, 0]
    y[:2] = SIGMA[0] * np.random.default_rng(seed).standard_normal((2, y.shape[1]))
    y[:3] = step * np.round(y[:3] / step)
    assert detect_outliers([shown(y, clean)]) == []


@pytest.mark.parametrize("seed", SEEDS)
def test_what_was_rounded_is_noise_again(seed):
    clean, y = white(np.random.default_rng(seed))
    y[2] = 0.04 * np.round(y[2] / 0.04)
    z = remove_rounding(shown(y, clean), 2) / SIGMA[0]
    print(f"seed {seed}: {np.std(z):.3f}, kurtosis {np.mean(z**4) / np.mean(z**2) ** 2:.2f}")
    assert kstest(z, "norm").pvalue > 0.01


@pytest.mark.parametrize("seed", SEEDS)
def test_one_step_of_the_zero_is_no_random_walk(seed):
    """As large as a walk would be, in all axes at once; the walks of the test below are found."""
    rng = np.random.default_rng(seed)
    clean, y = white(rng, 3000)
    y[:3, 1100:] += np.array([[0.004], [-0.006], [0.003]])
    assert detect_random_walk([shown(y, clean)]) == []


def repeated(rng, probability, step):
    """(clean, y, fresh): readings on a lattice, and some samples sent again."""
    clean, y = white(rng)
    y = step * np.round(y / step)
    late = rng.random(y.shape[1]) < probability
    late[0] = False
    for at in np.flatnonzero(late):
        y[:, at] = y[:, at - 1]
    fresh = np.concatenate([[True], (np.diff(y, axis=1) != 0.0).any(axis=0)])
    return clean, y, fresh


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


def beside_neighbours(residual, row):
    """z of a channel less the median of two neighbours on either side, and its robust sigma."""
    z = residual.value[row] / SIGMA[row]
    around = np.pad(z, 2, mode="reflect")
    z = z - [np.median(np.delete(around[k : k + 5], 2)) for k in range(len(z))]
    return z, np.median(np.abs(z)) / norm.ppf(0.75)


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


def walking(rng, k, count=3000):
    clean, y = white(rng, count)
    y[:3] += np.cumsum(k / np.sqrt(RATE_HZ) * rng.standard_normal((3, count)), axis=1)
    return clean, y


@pytest.mark.parametrize("seed", SEEDS)
def test_readings_that_are_sent_again_are_not_fresh_and_the_noise_is_that_of_the_others(seed):
    rng = np.random.default_rng(seed)
    clean, y = white(rng, 4000)
    late = np.append(False, rng.random(3999) < 0.4)
    for at in np.flatnonzero(late):
        y[:, at] = y[:, at - 1]
    declared = SimpleNamespace(model=SimpleNamespace(noise=SimpleNamespace(gyro=1e-3, accel=1e-3)))
    found = estimate_channel_noise(declared, shown(y, clean).node, SimpleNamespace(rolling=None), y - clean)
    assert (found.is_new == ~late).all()
    assert found.sigma.mean(axis=1) == pytest.approx(SIGMA[:, 0], rel=0.1)


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


@pytest.mark.parametrize(("times", "words"), [(1.0, ""), (1.1, ""), (3.0, "larger"), (0.3, "smaller")])
def test_noise_is_worth_a_line_where_it_is_not_as_declared(times, words):
    clean, y = white(np.random.default_rng(1))
    one = shown(y, clean)
    said = list(_list_noise({"left": replace(one, noise=replace(one.noise, group_sigmas=times * SIGMA))}))
    assert len(said) == (6 if words else 0)
    assert all(f"noise {words} than declared" in line.looks_like for line in said)
    assert all(f"{times:.2f} times what the model says" in line.looks_like for line in said)


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


def test_what_the_model_has_already_is_not_proposed_again():
    rng = np.random.default_rng(1)
    clean, y = walking(rng, 0.003)
    assert detect_random_walk([shown(y, clean, effects=["gyro_rate_random_walk"])]) == []
    clean, y, fresh = repeated(rng, 0.02, 0.3 * SIGMA)
    assert detect_repeats([shown(y, clean, fresh=fresh, effects=["sample_repeat"])]) == []
    clean, y = white(rng)
    y = np.clip(0.04 * np.round(y / 0.04), -5.0, 5.0)
    known = ["gyro_quantization", "gyro_saturation", "accel_saturation"]
    one = shown(y, clean, limits=(5.0, 5.0), effects=known)
    assert detect_limits([one]) == detect_quantization([one]) == []


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
