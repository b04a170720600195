"""Heading from a gyro whose warm-up is known: against filterpy, and with honest sigmas."""

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from generators import start_gyro as start
from hubodo.effects.warmup import WarmupModel
from hubodo.fuse.warm_heading import WarmHeading

DEG = math.pi / 180.0
MODEL = WarmupModel(start.C2 * DEG, start.C1 * DEG, start.T)


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


def test_it_is_filterpys_filter_of_two_states_in_rest_and_motion():
    noise, dt, walk = 0.01, 0.1, 0.001
    ours = WarmHeading(WarmupModel(0.0), noise, dt, offset_sigma=0.1, rate_random_walk=walk)
    theirs = KalmanFilter(2, 1, dim_u=1)
    theirs.x, theirs.P = np.zeros((2, 1)), np.diag([0.0, 0.1**2])
    theirs.H, theirs.R = np.array([[0.0, 1.0]]), np.array([[noise**2]])
    # The bias walks before the sample is taken, the heading moves with the bias after that walk.
    walked, turned = np.diag([0.0, walk**2 * dt]), np.array([[1.0, -dt], [0.0, 1.0]])
    rng = np.random.default_rng(5)
    for k in range(300):
        z, rest = rng.normal(0.02, noise), k % 100 < 60
        ours.handle(z, at_rest=rest)
        theirs.predict(F=np.eye(2), Q=walked)
        if rest:
            theirs.update(z)
        else:
            read = np.diag([(noise * dt) ** 2, 0.0])
            theirs.predict(u=np.array([[z]]), B=np.array([[dt], [0.0]]), F=turned, Q=read)
        state, spread = ours.state(), np.sqrt(np.diag(theirs.P))
        assert (state.heading, state.bias) == pytest.approx(theirs.x[:, 0], rel=1e-9, abs=1e-15)
        assert (state.sigma_heading, state.sigma_bias) == pytest.approx(spread, rel=1e-6, abs=1e-12)
