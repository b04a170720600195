"""Profile intervals of the warm-up: their coverage, open ends, and the intervals in the result."""

import numpy as np
import pytest
from scipy.optimize import minimize

from hubodo.sensors.warmup.characterise import characterise_warmup
from hubodo.sensors.warmup.profile_interval import profile_intervals

DEG = np.pi / 180.0
T = np.arange(0.0, 12 * 3600.0, 60.0)


def record(rng, c1=0.14, constant=2000.0, noise=0.28):
    """Return means in deg/s of half a day, one a minute."""
    return -0.3 - c1 * np.expm1(-T / constant) + noise * rng.standard_normal(len(T))


def contains(ends, value):
    low, high = ends
    return (low is None or low <= value) and (high is None or value <= high)


def test_intervals_cover_the_truth_in_nine_of_ten_records():
    """The noise of 200 records, seeds 0 to 199, is twice the warm-up."""
    covered = np.zeros(2)
    for seed in range(200):
        values = record(np.random.default_rng([seed, 92]))
        intervals = profile_intervals(T, values, 0.28**2)
        covered += [contains(intervals.c1, 0.14), contains(intervals.time_constant, 2000.0)]
    assert np.all(covered / 200 > 0.9), covered


def test_ends_are_those_of_a_likelihood_profiled_by_a_general_minimiser():
    """The cost at each end, with the other parameters at their optimum, exceeds the minimum by 3.84."""
    values = record(np.random.default_rng(5), c1=0.3, noise=0.1)
    intervals = profile_intervals(T, values, 0.1**2)

    def cost(c1, log_constant):
        model = -c1 * np.expm1(-T / np.exp(log_constant))
        residual = values - model
        return float(np.sum((residual - residual.mean()) ** 2)) / 0.1**2

    best = minimize(lambda p: cost(*p), [0.3, np.log(2000.0)], method="Nelder-Mead")
    for c1 in intervals.c1:
        profiled = minimize(lambda p, c1=c1: cost(c1, p[0]), best.x[1:], method="Nelder-Mead").fun
        assert profiled - best.fun == pytest.approx(3.84, abs=0.15)


def test_a_straight_line_leaves_the_upper_ends_open():
    intervals = profile_intervals(T, 1e-5 * T + 0.01 * np.random.default_rng(6).standard_normal(len(T)), 1e-4)
    assert intervals.c1[1] is None and intervals.time_constant[1] is None
    assert intervals.c1[0] > 0.1 and intervals.time_constant[0] > 20_000.0


def test_a_withheld_warm_up_has_an_interval_in_the_result():
    result = characterise_warmup(T, record(np.random.default_rng(7)) * DEG, "gz")
    content = result.as_json()
    assert content["c1"]["value"] is None and content["c1"]["reason"]
    assert contains(content["c1"]["interval"], 0.14 * DEG)
    assert contains(content["time_constant"]["interval"], 2000.0)
