"""The gap: rms of residuals in units of the declared noise."""

from dataclasses import replace

import numpy as np
import pytest

from gap_residuals import SIGMA, build_residual, draw_readings
from hubodo.gap.process_noise.residual import WalkSteps, compute_gap, compute_gap_floor


def test_the_gap_is_one_for_declared_noise_and_two_for_twice_that():
    clean, y = draw_readings(np.random.default_rng(5))
    residual = build_residual(y, clean)
    assert compute_gap({"left": residual}) == pytest.approx(1.0, rel=0.02)
    assert compute_gap({"left": replace(residual, value=2.0 * residual.value)}) == pytest.approx(
        2.0, rel=0.02
    )
    assert compute_gap_floor({"left": residual}) == pytest.approx(1.0)


def test_a_mask_restricts_the_gap_to_its_samples():
    clean, y = draw_readings(np.random.default_rng(6))
    y[:, :100] += 10.0 * SIGMA
    inside = np.arange(y.shape[1]) < 100
    residuals = {"left": build_residual(y, clean)}
    assert compute_gap(residuals, {"left": inside}) > 9.0
    assert compute_gap(residuals, {"left": ~inside}) < 1.1


def test_steps_of_a_walk_count_as_residuals_in_the_samples_of_a_mask():
    clean, y = draw_readings(np.random.default_rng(7))
    steps = WalkSteps(np.array([[100.0, -100.0, 0.0]]), np.array([10, 20, 900]))
    residual = build_residual(y, clean)
    walking = replace(residual, walk_steps=steps)
    count = np.count_nonzero(residual.node.used) * y.shape[1]
    expected = (compute_gap({"left": residual}) ** 2 * count + 2e4) / (count + 3)
    assert compute_gap({"left": walking}) ** 2 == pytest.approx(expected)
    late = np.arange(y.shape[1]) >= 500
    assert compute_gap({"left": walking}, {"left": late}) < 1.1
