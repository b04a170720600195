"""The filter of all random walks against a dense Gaussian with the same covariance."""

from dataclasses import replace

import numpy as np
import pytest

from hubodo.gap.process_noise.innovations import filter_innovations
from hubodo.gap.process_noise.walk_likelihood import smooth_walk, walk_log_likelihoods
from hubodo.gap.process_noise.window_sums import NodeSegment, RandomWalk

WINDOW_S, WINDOWS_PER_BLOCK, N_COLUMNS = 0.5, 3, 2
# A wheel phase of unknown start, a slow walk, white noise drawn once per window, and a process that forgets.
WALKS = (
    RandomWalk(0.02, start_variance=1e5),
    RandomWalk(0.1, start_variance=0.01),
    RandomWalk(0.0, start_variance=0.3, is_white=True),
    RandomWalk(0.0, start_variance=0.2, correlation_time=1.2),
)
# Covariance of the steps of the first two walks, per second.
STEP_COVARIANCE = np.zeros((4, 4))
STEP_COVARIANCE[0, 1] = STEP_COVARIANCE[1, 0] = 0.03
SEEDS = (1, 2, 3)


def draw_segments(seed):
    """Return segments and walk offsets of two nodes with uneven rates, empty windows and different walks."""
    rng = np.random.default_rng(seed)
    segments = []
    for counts, column_indices, noise_indices in (
        ((4, 3, 5, 4, 2, 4, 3), (0, 1), (0, 2, 3)),
        ((3, 0, 2, 4, 4, 0, 5), (1,), (1, 2, 3)),
    ):
        edges = np.concatenate([[0], np.cumsum(counts)])
        n = edges[-1]
        segments.append(
            NodeSegment(
                edges,
                rng.standard_normal((len(column_indices), 6, n)).astype(np.float32),
                column_indices,
                rng.standard_normal((6, n)),
                rng.uniform(0.5, 2.0, (6, n)),
                rng.standard_normal((len(noise_indices), 6, n)),
                noise_indices,
            )
        )
    offsets = np.zeros((len(WALKS), len(counts)))
    offsets[0] = 0.3 * rng.standard_normal(len(counts)).cumsum()
    return segments, offsets


def split_at_first_block(segments):
    """Return the same segments in two parts, cut after the first block."""
    bounds = ((0, WINDOWS_PER_BLOCK), (WINDOWS_PER_BLOCK, None))
    return [[cut_windows(segment, first, end) for segment in segments] for first, end in bounds]


def cut_windows(segment, first, end):
    """Return windows `first` to `end` of a segment."""
    edges = segment.edges[first : None if end is None else end + 1]
    inside = slice(edges[0], edges[-1])
    arrays = {
        name: getattr(segment, name)[..., inside] for name in ("columns", "z", "weight", "noise_columns")
    }
    return replace(segment, edges=edges - edges[0], **arrays)


def build_dense_gaussian(segments, stacked_offsets):
    """Return readings y, columns X, rows A and prior covariance S of the walks, and their stacked offsets."""
    windows, count = len(segments[0].edges) - 1, len(WALKS)
    ys, xs, walk_rows = [], [], []
    for segment in segments:
        for k in range(windows):
            for n in range(segment.edges[k], segment.edges[k + 1]):
                for row in range(6):
                    w = segment.weight[row, n]
                    ys.append(segment.z[row, n])
                    x, a = np.zeros(N_COLUMNS), np.zeros((windows, count))
                    x[list(segment.column_indices)] = w * segment.columns[:, row, n]
                    a[k, list(segment.noise_indices)] = w * segment.noise_columns[:, row, n]
                    xs.append(x)
                    walk_rows.append(a.ravel())
    prior = np.zeros((windows, count, windows, count))
    for c, walk in enumerate(WALKS):
        later = np.minimum.outer(np.arange(windows), np.arange(windows))
        apart = WINDOW_S * np.abs(np.subtract.outer(np.arange(windows), np.arange(windows)))
        if np.isfinite(walk.correlation_time):
            prior[:, c, :, c] = walk.start_variance * np.exp(-apart / walk.correlation_time)
            continue
        walk_prior = (
            np.eye(windows) * walk.start_variance
            if walk.is_white
            else walk.start_variance + walk.intensity * WINDOW_S * later
        )
        prior[:, c, :, c] = walk_prior
    for c, d in zip(*np.nonzero(STEP_COVARIANCE), strict=True):
        prior[:, c, :, d] = STEP_COVARIANCE[c, d] * WINDOW_S * later
    size = windows * count
    return (
        np.array(ys),
        np.array(xs),
        np.array(walk_rows),
        prior.reshape(size, size),
        stacked_offsets.T.ravel(),
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gram_matrices_sum_to_the_quadratic_form_of_the_dense_gaussian(seed):
    segments, offsets = draw_segments(seed)
    y, x, a, prior, stacked_offsets = build_dense_gaussian(segments, offsets)
    result = filter_innovations(
        split_at_first_block(segments),
        WALKS,
        offsets,
        N_COLUMNS,
        WINDOW_S,
        WINDOWS_PER_BLOCK,
        step_covariance=STEP_COVARIANCE,
    )
    covariance = np.eye(len(y)) + a @ prior @ a.T
    # Residuals are relative to the offsets; adding a @ path gives them relative to the model without walks.
    both = np.column_stack([x, y + a @ stacked_offsets])
    np.testing.assert_allclose(result.grams.sum(), both.T @ np.linalg.solve(covariance, both), rtol=2e-5)
    assert result.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-6)
    assert len(result.grams) == 3
    # Marginalising the walks only reduces the information of a column.
    assert result.raw_squares[-1] == pytest.approx(y @ y, rel=1e-5)
    assert (np.diag(result.grams.sum())[:-1] < result.raw_squares[:-1]).all()


def test_columns_are_squared_channel_by_channel():
    segments, offsets = draw_segments(SEEDS[0])
    _, x, *_ = build_dense_gaussian(segments, offsets)
    # A walk with a free start would be removed from the columns before.
    walks = (replace(WALKS[0], start_variance=1.0), *WALKS[1:])
    result = filter_innovations(
        split_at_first_block(segments), walks, offsets, N_COLUMNS, WINDOW_S, WINDOWS_PER_BLOCK
    )
    # Rows are ordered by node, window and sample, and alternate between six channels.
    nodes = np.split(x**2, np.cumsum([segment.z.size for segment in segments])[:-1])
    expected = np.concatenate([node.reshape(-1, 6, N_COLUMNS).sum(axis=0) for node in nodes])
    np.testing.assert_allclose(result.channel_squares, expected.T, rtol=1e-5)


@pytest.mark.parametrize("seed", SEEDS)
def test_smoothed_walks_are_the_conditional_mean_of_the_dense_gaussian(seed):
    segments, offsets = draw_segments(seed)
    y, _, a, prior, stacked_offsets = build_dense_gaussian(segments, offsets)
    result = filter_innovations(
        split_at_first_block(segments),
        WALKS,
        offsets,
        N_COLUMNS,
        WINDOW_S,
        WINDOWS_PER_BLOCK,
        smooth=True,
        step_covariance=STEP_COVARIANCE,
    )
    covariance = np.eye(len(y)) + a @ prior @ a.T
    expected = prior @ a.T @ np.linalg.solve(covariance, y + a @ stacked_offsets) - stacked_offsets
    np.testing.assert_allclose(result.smoothed.ravel(), expected, atol=1e-5)


@pytest.mark.parametrize("seed", SEEDS)
def test_likelihood_and_smoothing_of_a_single_walk_match_the_dense_gaussian(seed):
    rng = np.random.default_rng(seed)
    observed, variance, intervals = (
        rng.standard_normal(12),
        rng.uniform(0.1, 1.0, 12),
        rng.uniform(0.4, 0.6, 11),
    )
    intensities, starts = np.array([0.0, 0.05, 2.0]), np.array([0.3, 0.1, 5.0])
    times = np.concatenate([[0.0], np.cumsum(intervals)])
    log_likelihoods = walk_log_likelihoods(observed, variance, intervals, intensities, starts)
    for log_likelihood, q, start in zip(log_likelihoods, intensities, starts, strict=True):
        prior = start + q * np.minimum.outer(times, times)
        covariance = prior + np.diag(variance)
        density = -0.5 * (observed @ np.linalg.solve(covariance, observed) + np.linalg.slogdet(covariance)[1])
        assert log_likelihood == pytest.approx(density, abs=1e-9)
        smoothed = smooth_walk(observed, variance, intervals, q, start)
        np.testing.assert_allclose(smoothed, prior @ np.linalg.solve(covariance, observed), atol=1e-9)


def test_without_walks_the_gram_matrices_are_plain_products():
    segments, offsets = draw_segments(1)
    segments = [
        replace(segment, noise_columns=segment.noise_columns[:0], noise_indices=()) for segment in segments
    ]
    y, x, _, _, _ = build_dense_gaussian(segments, offsets)
    both = np.column_stack([x, y])
    result = filter_innovations([segments], (), offsets[:0], N_COLUMNS, WINDOW_S, WINDOWS_PER_BLOCK)
    np.testing.assert_allclose(result.grams.sum(), both.T @ both, rtol=1e-5)
    assert result.log_determinant == 0.0
