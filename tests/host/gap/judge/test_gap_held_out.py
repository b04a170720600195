"""Held-out samples."""

import numpy as np

from hubodo.gap.judge.held_out import split_held_out


def test_held_out_samples_have_infinite_sigma(evaluation):
    split = split_held_out(evaluation.problem)
    weights = split.exclude_from(evaluation.weights)
    for node in evaluation.problem.nodes:
        held_out = split.masks[node.name]
        assert 0.1 < held_out.mean() < 0.5
        sigma = weights.noise[node.name].sigma
        assert np.isinf(sigma[:, held_out]).all() and np.isfinite(sigma[:, ~held_out]).all()
