"""Six-state filter of the paper and the filter driven by the rate: against textbook forms, and honest "
"sigmas."""

import math

import numpy as np
import pytest

from generators import start_gyro as start
from hubodo.effects.warmup_models import WarmupModel
from hubodo.fuse.six_state import SixState, _white_noise
from hubodo.fuse.warm_heading import WarmHeading

DEG = math.pi / 180.0
MODEL = WarmupModel(start.C2 * DEG, start.C1 * DEG, start.T)


def test_the_process_noise_is_the_integral_of_bar_shalom():
    """Q = integral of Phi(s) g g' Phi(s)' ds, done numerically for a chain of four integrators."""
    dt, steps = 0.05, 20_000
    s = (np.arange(steps) + 0.5) * dt / steps
    column = np.array([s**3 / 6, s**2 / 2, s, np.ones_like(s)])
    assert _white_noise(4, dt) == pytest.approx(column @ column.T * dt / steps, rel=1e-6)


def test_the_six_states_are_a_textbook_kalman_filter():
    """The same recursion written out with full matrices and the Joseph form, on 200 samples."""
    rng = np.random.default_rng(7)
    filter_ = SixState(MODEL.c1, MODEL.c2, MODEL.time_constant, 0.2 * DEG, 0.05)
    rates = rng.normal(0.1, 0.2, 200) * DEG
    heading, rate, bias = filter_.run(rates, np.array(-0.3 * DEG), 2000)
    transition, drive = filter_._transition()
    x, h, r = np.array([0, 0, 0, 0, 0, -0.3 * DEG]), np.array([[0, 1.0, 0, 0, 0, 1.0]]), (0.2 * DEG) ** 2
    p = np.diag([0, r, DEG**2, DEG**2, 0, r / 2000])
    for k, z in enumerate(rates):
        x = transition @ x + np.array([0, 0, 0, 0, 0, drive])
        p = transition @ p @ transition.T + filter_._process_noise()
        gain = p @ h.T / (h @ p @ h.T + r)
        x = x + gain[:, 0] * (z - (h @ x)[0])
        keep = np.eye(6) - gain @ h
        p = keep @ p @ keep.T + gain @ gain.T * r
        assert (heading[k], rate[k], bias[k]) == pytest.approx((x[0], x[1], x[5]), rel=1e-6, abs=1e-12)


def driven(case, seed):
    rate, output, age = start.run(case, np.random.default_rng(seed))
    ours = WarmHeading(MODEL, start.NOISE * DEG, start.DT, age=age)
    error, heading = [], 0.0
    for k, value in enumerate(output.tolist()):
        ours.handle(value * DEG, at_rest=k < start.AVERAGED)
        heading += rate[k] * DEG * start.DT
        error.append(ours.state().heading - heading)
    return np.array(error[start.AVERAGED :]) / DEG, ours.state()


@pytest.mark.parametrize("case", start.DRIFTS_DEG)
def test_the_error_is_ten_times_smaller_and_as_large_as_the_filter_says(case):
    seeds = range(16)
    runs = [driven(case, seed) for seed in seeds]
    ends = np.array([error[-1] for error, _ in runs])
    sigma = runs[0][1].sigma_heading / DEG
    bound = start.NOISE / math.sqrt(start.AVERAGED) * start.RUN * start.DT
    print(
        f"{case}, seeds {seeds}: rms {np.sqrt(np.mean(ends**2)):.2f} deg, sigma {sigma:.2f}, bound "
        f"{bound:.2f}"
    )
    assert abs(start.DRIFTS_DEG[case]) / np.median(np.abs(ends)) > 10
    assert bound < sigma < 2 * bound
    # Chi-square with 16 degrees of freedom lies between 3.9 and 38 in 99.8 % of cases.
    assert 3.9 < np.sum((ends / sigma) ** 2) < 38


def test_a_step_of_the_rate_leaves_no_peak():
    error, _ = driven("random rates", 3)
    parts = error.reshape(10, -1)
    jumps = np.abs(parts[1:, :100] - parts[:-1, -1:]).max()
    # Five seconds of white noise: 0.2 deg/s sqrt(0.05 s 5 s) = 0.1 deg, and the drift of the bias.
    assert jumps < 0.6


def test_two_states_are_a_textbook_kalman_filter_in_rest_and_motion():
    rng = np.random.default_rng(5)
    ours = WarmHeading(WarmupModel(0.0), 0.01, 0.1, offset_sigma=0.1, rate_random_walk=0.001)
    x, p, r = np.zeros(2), np.diag([0.0, 0.01]), 1e-4
    for k in range(300):
        z, rest = rng.normal(0.02, 0.01), k % 100 < 60
        ours.handle(z, at_rest=rest)
        p = p + np.diag([0.0, 1e-6 * 0.1])
        if rest:
            h = np.array([[0.0, 1.0]])
            gain = p @ h.T / (h @ p @ h.T + r)
            x, p = x + gain[:, 0] * (z - x[1]), (np.eye(2) - gain @ h) @ p
        else:
            f = np.array([[1.0, -0.1], [0.0, 1.0]])
            x, p = f @ x + np.array([0.1 * z, 0.0]), f @ p @ f.T + np.diag([0.01 * r, 0.0])
        state = ours.state()
        assert (state.heading, state.bias) == pytest.approx(tuple(x), rel=1e-9, abs=1e-15)
        assert (state.sigma_heading, state.sigma_bias) == pytest.approx(
            tuple(np.sqrt(np.diag(p))), rel=1e-6, abs=1e-12
        )
