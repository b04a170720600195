"""The filter of everything that wanders, against the same Gaussian written down as one large matrix."""

from dataclasses import replace

import numpy as np
import pytest

from hubodo.gap.process_noise.innovations import filter_innovations
from hubodo.gap.process_noise.walk_likelihood import smooth_walk, walk_log_likelihoods
from hubodo.gap.process_noise.window_sums import NodeSegment, RandomWalk

WINDOW, BLOCK, COLUMNS = 0.5, 3, 2
# A wheel whose first angle is unknown, something slow, and something that is new in each window.
WALKS = (
    RandomWalk(0.02, start_variance=1e5),
    RandomWalk(0.1, start_variance=0.01),
    RandomWalk(0.0, start_variance=0.3, is_white=True),
)
# What the steps of the first two have in common, per second.
TOGETHER = np.zeros((3, 3))
TOGETHER[0, 1] = TOGETHER[1, 0] = 0.03
SEEDS = (1, 2, 3)


def drawn(seed):
    """Two nodes of uneven rates, one with nothing in two windows; what each feels of the walks differs."""
    rng = np.random.default_rng(seed)
    shares = []
    for counts, at, feels in (((4, 3, 5, 4, 2, 4, 3), (0, 1), (0, 2)), ((3, 0, 2, 4, 4, 0, 5), (1,), (1, 2))):
        edges = np.concatenate([[0], np.cumsum(counts)])
        n = edges[-1]
        shares.append(
            NodeSegment(
                edges,
                rng.standard_normal((len(at), 6, n)).astype(np.float32),
                at,
                rng.standard_normal((6, n)),
                rng.uniform(0.5, 2.0, (6, n)),
                rng.standard_normal((len(feels), 6, n)),
                feels,
            )
        )
    paths = np.zeros((len(WALKS), len(counts)))
    paths[0] = 0.3 * rng.standard_normal(len(counts)).cumsum()
    return shares, paths


def in_parts(shares):
    """The same shares, cut behind the first block."""
    made = []
    for first, end in ((0, BLOCK), (BLOCK, None)):
        made.append([cut(share, first, end) for share in shares])
    return made


def cut(share, first, end):
    """Some windows of a share."""
    edges = share.edges[first : None if end is None else end + 1]
    inside = slice(edges[0], edges[-1])
    arrays = {name: getattr(share, name)[..., inside] for name in ("columns", "z", "weight", "noise_columns")}
    return replace(share, edges=edges - edges[0], **arrays)


def dense(shares, path):
    """(y, X, A, S, path): all readings, columns, answers to walks in their windows, and the walks' prior."""
    windows, count = len(shares[0].edges) - 1, len(WALKS)
    ys, xs, answers = [], [], []
    for share in shares:
        for k in range(windows):
            for n in range(share.edges[k], share.edges[k + 1]):
                for row in range(6):
                    w = share.weight[row, n]
                    ys.append(share.z[row, n])
                    x, a = np.zeros(COLUMNS), np.zeros((windows, count))
                    x[list(share.column_indices)] = w * share.columns[:, row, n]
                    a[k, list(share.noise_indices)] = w * share.noise_columns[:, row, n]
                    xs.append(x)
                    answers.append(a.ravel())
    prior = np.zeros((windows, count, windows, count))
    for c, walk in enumerate(WALKS):
        later = np.minimum.outer(np.arange(windows), np.arange(windows))
        one = (
            np.eye(windows) * walk.start_variance
            if walk.is_white
            else walk.start_variance + walk.intensity * WINDOW * later
        )
        prior[:, c, :, c] = one
    for c, d in zip(*np.nonzero(TOGETHER), strict=True):
        prior[:, c, :, d] = TOGETHER[c, d] * WINDOW * later
    size = windows * count
    return np.array(ys), np.array(xs), np.array(answers), prior.reshape(size, size), path.T.ravel()


@pytest.mark.parametrize("seed", SEEDS)
def test_the_grams_add_up_to_the_quadratic_forms_of_one_gaussian(seed):
    shares, paths = drawn(seed)
    y, x, a, prior, path = dense(shares, paths)
    found = filter_innovations(
        in_parts(shares), WALKS, paths, COLUMNS, WINDOW, BLOCK, step_covariance=TOGETHER
    )
    whole = np.eye(len(y)) + a @ prior @ a.T
    # The residual was taken about the path: the reading beside the model without it.
    both = np.column_stack([x, y + a @ path])
    np.testing.assert_allclose(found.grams.sum(), both.T @ np.linalg.solve(whole, both), rtol=2e-5)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(whole)[1], rel=1e-6)
    assert len(found.grams) == 3
    # Nothing that was taken out can have added to what a column says.
    assert found.raw_squares[-1] == pytest.approx(y @ y, rel=1e-5)
    assert (np.diag(found.grams.sum())[:-1] < found.raw_squares[:-1]).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_the_walks_are_where_the_gaussian_expects_them(seed):
    shares, paths = drawn(seed)
    y, _, a, prior, path = dense(shares, paths)
    found = filter_innovations(
        in_parts(shares), WALKS, paths, COLUMNS, WINDOW, BLOCK, smooth=True, step_covariance=TOGETHER
    )
    whole = np.eye(len(y)) + a @ prior @ a.T
    expected = prior @ a.T @ np.linalg.solve(whole, y + a @ path) - path
    np.testing.assert_allclose(found.smoothed.ravel(), expected, atol=1e-5)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_single_walk_scores_and_is_smoothed_as_the_gaussian_says(seed):
    rng = np.random.default_rng(seed)
    seen, variance, steps = rng.standard_normal(12), rng.uniform(0.1, 1.0, 12), rng.uniform(0.4, 0.6, 11)
    intensities, starts = np.array([0.0, 0.05, 2.0]), np.array([0.3, 0.1, 5.0])
    at = np.concatenate([[0.0], np.cumsum(steps)])
    likely = walk_log_likelihoods(seen, variance, steps, intensities, starts)
    for one, q, start in zip(likely, intensities, starts, strict=True):
        prior = start + q * np.minimum.outer(at, at)
        whole = prior + np.diag(variance)
        density = -0.5 * (seen @ np.linalg.solve(whole, seen) + np.linalg.slogdet(whole)[1])
        assert one == pytest.approx(density, abs=1e-9)
        made = smooth_walk(seen, variance, steps, q, start)
        np.testing.assert_allclose(made, prior @ np.linalg.solve(whole, seen), atol=1e-9)


def test_nothing_that_wanders_leaves_plain_products():
    shares, paths = drawn(1)
    shares = [replace(share, noise_columns=share.noise_columns[:0], noise_indices=()) for share in shares]
    y, x, _, _, _ = dense(shares, paths)
    both = np.column_stack([x, y])
    found = filter_innovations([shares], (), paths[:0], COLUMNS, WINDOW, BLOCK)
    np.testing.assert_allclose(found.grams.sum(), both.T @ both, rtol=1e-5)
    assert found.log_determinant == 0.0
