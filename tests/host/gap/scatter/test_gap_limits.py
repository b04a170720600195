"""Detection of saturation limits, against explicit sums of log densities."""

import numpy as np
import pytest
from scipy.stats import norm

from gap_residuals import SEEDS, SIGMA, build_residual, draw_readings, find_by_scope
from hubodo.gap.scatter.limits import detect_limits


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "rows", "limit"), [("gyro", (0, 3), 5.5), ("accel", (3, 6), 8.0)])
def test_the_gain_of_a_limit_is_the_log_density_ratio_of_the_clipped_model(seed, name, rows, limit):
    """A sample counts for at most 20 sigma, so that a single dropout to zero does not dominate."""
    rng = np.random.default_rng(seed)
    clean, y = draw_readings(rng)
    channels = slice(*rows)
    y[channels] = np.clip(y[channels], -limit, limit)
    is_clipped = np.abs(clean[channels]) > limit
    assert is_clipped.sum() > 100
    row, index = np.argwhere(is_clipped)[0]
    y[rows[0] + row, index] = 0.0
    limits = (limit, np.inf) if name == "gyro" else (np.inf, limit)
    proposals = detect_limits([build_residual(y, clean, limits=limits)])
    assert [(it.term.effect.name, it.term.scope) for it in proposals] == [(f"{name}_saturation", "left")]
    assert proposals[0].term.effect.limit == limit

    def log_density(mean):
        density_at_20_sigma = norm.logpdf(20.0 * SIGMA[channels], scale=SIGMA[channels])
        return float(np.sum(np.maximum(norm.logpdf(y[channels], mean, SIGMA[channels]), density_at_20_sigma)))

    gain = log_density(np.clip(clean[channels], -limit, limit)) - log_density(clean[channels])
    assert gain > 100.0
    assert proposals[0].gain == pytest.approx(gain, rel=1e-9)


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
