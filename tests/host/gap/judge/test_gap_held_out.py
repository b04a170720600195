"""Held-out samples."""

import numpy as np
import pytest

from hubodo.gap.judge.held_out import measure_held_out, split_held_out
from hubodo.gap.process_noise.residual import compute_gap


def test_held_out_samples_have_infinite_sigma(evaluation):
    split = split_held_out(evaluation.problem)
    weights = split.exclude_from(evaluation.weights)
    for node in evaluation.problem.nodes:
        held_out = split.masks[node.name]
        assert 0.1 < held_out.mean() < 0.5
        sigma = weights.noise[node.name].sigma
        assert np.isinf(sigma[:, held_out]).all() and np.isfinite(sigma[:, ~held_out]).all()


def test_squares_of_held_out_blocks_add_up_to_the_gap(evaluation):
    split = split_held_out(evaluation.problem)
    measured = measure_held_out(evaluation.residuals, split.masks)
    steps = [one.walk_steps for one in evaluation.residuals.values()]
    masks = [split.masks[name] for name in evaluation.residuals]
    n_steps = sum(walk.steps[:, mask[walk.samples]].size for walk, mask in zip(steps, masks, strict=True))
    n_readings = sum(
        mask.sum() * len(np.flatnonzero(one.node.used))
        for mask, one in zip(masks, evaluation.residuals.values(), strict=True)
    )
    assert measured.gap == compute_gap(evaluation.residuals, split.masks)
    assert measured.block_squares.sum() == pytest.approx(measured.gap**2 * (n_steps + n_readings))
    assert len(measured.block_squares) >= 4
