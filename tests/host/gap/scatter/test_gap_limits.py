"""Detection of saturation limits, against sums written out."""

import numpy as np
import pytest
from scipy.stats import norm

from gap_residuals import SEEDS, SIGMA, only, shown, white
from hubodo.gap.scatter.limits import detect_limits


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
