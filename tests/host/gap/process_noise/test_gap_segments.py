"""Segments of a log: each sample and each window belongs to exactly one."""

from itertools import pairwise

import numpy as np

from hubodo.gap.process_noise.segments import split_segments, window_edges, window_grid, window_means


def test_segments_contain_each_sample_and_each_window_once(problem):
    segments = split_segments(problem)
    grid = window_grid(problem)
    np.testing.assert_array_equal(np.concatenate([segment.window_starts for segment in segments]), grid)
    for node in problem.nodes:
        bounds = [(segment.samples[node.name].start, segment.samples[node.name].stop) for segment in segments]
        assert bounds[0][0] == 0 and bounds[-1][1] == len(node.t)
        assert all(end == start for (_, end), (start, _) in pairwise(bounds))


def test_the_mean_of_a_window_without_samples_is_interpolated(problem):
    node = problem.nodes[0]
    edges = window_edges(window_grid(problem), node)
    np.testing.assert_allclose(window_means(np.full(len(node.t), 3.0), edges), 3.0)
    np.testing.assert_allclose(
        window_means(np.array([1.0, 1.0, 3.0]), np.array([0, 2, 2, 3])), [1.0, 2.0, 3.0]
    )
