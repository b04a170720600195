"""Detection of saturation limits, against explicit sums of log densities."""

import numpy as np
import pytest
from scipy.stats import norm

from gap_residuals import SEEDS, SIGMA, build_residual, draw_readings, find_by_scope
from hubodo.gap.scatter.limits import detect_limits


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "rows", "limit"), [("gyro", (0, 3), 5.5), ("accel", (3, 6), 8.0)])
def test_the_gain_of_a_limit_is_the_log_density_ratio_of_the_clipped_model(seed, name, rows, limit):
    """A reading at the limit is in the tail, or without a limit in one step of the lattice there.

    A prediction is believed up to 20 sigma, and the largest gain does not count.
    """
    channels, step = slice(*rows), 0.004
    clean, y = draw_readings(np.random.default_rng(seed))
    y[channels] = np.clip(step * np.round(y[channels] / step), -limit, limit)
    is_clipped = np.abs(y[channels]) == limit
    assert is_clipped.sum() > 100
    limits = (limit, np.inf) if name == "gyro" else (np.inf, limit)
    proposals = detect_limits([build_residual(y, clean, limits=limits)])
    assert [(it.term.effect.name, it.term.scope) for it in proposals] == [(f"{name}_saturation", "left")]
    assert proposals[0].term.effect.limit == limit
    sigma = np.broadcast_to(SIGMA[channels], y[channels].shape)
    distance = np.clip((limit - np.sign(y[channels]) * clean[channels]) / sigma, -20.0, 20.0)
    without_limit = norm.logpdf(distance) + np.log(step / sigma)
    gains = (norm.logsf(distance) - without_limit)[is_clipped]
    assert proposals[0].gain == pytest.approx(float(gains.sum() - gains.max()), rel=1e-9)
    assert proposals[0].is_exact


@pytest.mark.parametrize("seed", SEEDS)
def test_a_limit_beyond_all_predictions_shows_in_equal_readings(seed):
    """Readings that noise alone carries beyond the limit pile up at it."""
    clean, y = draw_readings(np.random.default_rng(seed), 4000)
    limit = float(np.quantile(np.abs(y[:3]), 0.996))
    y[:3] = np.clip(0.004 * np.round(y[:3] / 0.004), -limit, limit)
    (proposal,) = detect_limits([build_residual(y, clean, limits=(limit, np.inf))])
    count = int((np.abs(y[:3]) == limit).sum())
    print(f"seed {seed}: {proposal.gain:.0f} nats of {count} readings at the limit")
    assert proposal.gain > count


@pytest.mark.parametrize("step", [0.01, 0.05])
def test_the_sigma_of_a_limit_is_half_a_quantization_step(step):
    clean, y = draw_readings(np.random.default_rng(1))
    y[:3] = np.clip(step * np.round(y[:3] / step), -5.5, 5.5)
    (proposal,) = detect_limits([build_residual(y, clean, limits=(5.5, np.inf))])
    assert proposal.sigmas["limit"] == pytest.approx(0.5 * step)


def test_a_limit_is_shared_by_all_nodes_only_if_it_is_equal():
    clean, y = draw_readings(np.random.default_rng(1))
    residuals = []
    for name, limit in (("left", 8.0), ("right", 8.0), ("third", 7.0)):
        clipped = np.concatenate([y[:3], np.clip(y[3:], -limit, limit)])
        residuals.append(build_residual(clipped, clean, name=name, limits=(np.inf, limit)))
    proposals_of_two = detect_limits(residuals[:2])
    assert find_by_scope(proposals_of_two, "all").gain == pytest.approx(
        find_by_scope(proposals_of_two, "left").gain + find_by_scope(proposals_of_two, "right").gain
    )
    assert [it.term.scope for it in detect_limits(residuals)] == ["left", "right", "third"]


@pytest.mark.parametrize(("highest", "scopes"), [(8.0, {"left", "all"}), (7.9, {"left"}), (8.3, {"left"})])
def test_one_reading_of_another_node_at_the_limit_shows_that_both_have_it(highest, scopes):
    """The gain of `all` is that of the node with many readings there, and of that one reading."""
    clean, y = draw_readings(np.random.default_rng(1))
    left = np.concatenate([y[:3], np.clip(y[3:], -8.0, 8.0)])
    right = np.concatenate([y[:3], 0.7 * y[3:]])
    right[3, 700] = highest
    assert np.count_nonzero(np.abs(right[3:]) >= 7.9) == 1
    residuals = [
        build_residual(left, clean, name="left", limits=(np.inf, 8.0)),
        build_residual(right, np.concatenate([clean[:3], 0.7 * clean[3:]]), name="right"),
    ]
    proposals = detect_limits(residuals)
    assert {it.term.scope for it in proposals} == scopes
    if "all" in scopes:
        distance = (8.0 - 0.7 * clean[3, 700]) / SIGMA[3, 0]
        one = float(norm.logsf(min(distance, 20.0)) - norm.logpdf(min(distance, 20.0)) - np.log(1e-3))
        gain = find_by_scope(proposals, "left").gain
        assert find_by_scope(proposals, "all").gain == pytest.approx(gain + one)
