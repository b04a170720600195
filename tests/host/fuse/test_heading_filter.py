"""Heading filter with a warm-up model, compared with filterpy; errors agree with sigmas."""

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from generators import start_gyro as start
from hubodo.effects.warmup import WarmupModel
from hubodo.fuse.heading_filter import BiasNoise, HeadingFilter

DEG = math.pi / 180.0
MODEL = WarmupModel(start.C2 * DEG, start.C1 * DEG, start.T)


def driven(case, seeds):
    """Return (M, 6000) errors in degrees of the filter and of a plain mean, and the last state."""
    runs = [start.run(case, np.random.default_rng(seed)) for seed in seeds]
    output = np.array([produced for _, produced, _ in runs])
    noise = BiasNoise(start.NOISE * DEG * math.sqrt(start.DT))
    ours = HeadingFilter(MODEL, noise, age=start.AGES[case], shape=(len(runs),))
    heading = []
    for k, values in enumerate(output.T):
        ours.update(values * DEG, start.DT, is_stationary=k < start.AVERAGED)
        heading.append(ours.state().heading)
    truth = np.cumsum([rate[start.AVERAGED :] for rate, _, _ in runs], axis=1) * start.DT
    moving = output[:, start.AVERAGED :] - output[:, : start.AVERAGED].mean(axis=1)[:, None]
    mean = np.cumsum(moving, axis=1) * start.DT - truth
    return np.array(heading[start.AVERAGED :]).T / DEG - truth, mean, ours.state()


@pytest.mark.parametrize("case", start.DRIFTS_DEG)
def test_the_error_is_near_the_lower_bound_and_agrees_with_the_sigma(case):
    """The lower bound is the white noise over the standstill; a cold gyro's mean has its warm-up."""
    seeds = range(16)
    errors, mean, state = driven(case, seeds)
    ends, sigma = errors[:, -1], state.sigma_heading / DEG
    bound = start.NOISE / math.sqrt(start.AVERAGED) * start.RUN * start.DT
    print(f"{case}, {seeds}: rms {np.sqrt(np.mean(ends**2)):.2f} deg, sigma {sigma:.2f}, bound {bound:.2f}")
    reference_filter = np.sqrt(np.mean(mean[:, -1] ** 2))
    assert np.sqrt(np.mean(ends**2)) < (1.1 if case == "warmed up" else 0.5) * reference_filter
    assert bound < sigma < 2 * bound
    # Chi-square with 16 degrees of freedom lies between 3.9 and 38 in 99.8 % of cases.
    assert 3.9 < np.sum((ends / sigma) ** 2) < 38


def test_a_step_of_the_rate_causes_no_error_peak():
    errors, _, _ = driven("random rates", [3])
    parts = errors[0].reshape(10, -1)
    jumps = np.abs(parts[1:, :100] - parts[:-1, -1:]).max()
    # Five seconds of white noise: 0.2 deg/s sqrt(0.05 s 5 s) = 0.1 deg, and the drift of the bias.
    assert jumps < 0.6


def test_with_two_states_it_equals_filterpy_at_standstill_and_in_motion():
    noise, dt, walk = 0.01, 0.1, 0.001
    ours = HeadingFilter(
        WarmupModel(0.0), BiasNoise(noise * math.sqrt(dt), rate_random_walk=walk, offset=0.1)
    )
    theirs = KalmanFilter(2, 1, dim_u=1)
    theirs.x, theirs.P = np.zeros((2, 1)), np.diag([0.0, 0.1**2])
    theirs.H, theirs.R = np.array([[0.0, 1.0]]), np.array([[noise**2]])
    # The bias is propagated before the sample, and the heading uses the propagated bias.
    walked, turned = np.diag([0.0, walk**2 * dt]), np.array([[1.0, -dt], [0.0, 1.0]])
    rng = np.random.default_rng(5)
    for k in range(300):
        z, remaining = rng.normal(0.02, noise), k % 100 < 60
        ours.update(z, dt, is_stationary=remaining)
        theirs.predict(F=np.eye(2), Q=walked)
        if remaining:
            theirs.update(z)
        else:
            read = np.diag([(noise * dt) ** 2, 0.0])
            theirs.predict(u=np.array([[z]]), B=np.array([[dt], [0.0]]), F=turned, Q=read)
        agree(ours, theirs.x, theirs.P, [0.0, 1.0])


def test_with_warm_up_errors_and_flicker_it_equals_filterpy():
    """The case has all states and uneven intervals: offset, c1, T, temperature, Markov processes."""
    model = WarmupModel(0.002, 0.02, 300.0, temperature_coefficient=1e-4)
    sigmas = {"c1": 0.004, "time_constant": 40.0, "temperature_coefficient": 3e-5}
    n, b, k_walk = 1e-3, 2e-3, 1e-5
    ours = HeadingFilter(model, BiasNoise(n, b, k_walk, 0.01, sigmas), age=20.0)
    # Time constants of 1, 5, 25, .. s up to 1e5 s, B^2 ln 5 / pi each.
    constants = 5.0 ** np.arange(8)
    count = 5 + len(constants)
    theirs = KalmanFilter(count, 1)
    each = b**2 * math.log(5.0) / math.pi
    theirs.x = np.zeros((count, 1))
    theirs.P = np.diag([0.0, 0.01**2, 0.004**2, 40.0**2, 3e-5**2, *[each] * len(constants)])
    rng, age = np.random.default_rng(8), 20.0
    for k in range(200):
        dt, warm = rng.uniform(0.5, 2.0), rng.uniform(20.0, 30.0)
        z, remaining, doubt = rng.normal(0.02, 0.01), k % 100 < 40, 0.003 if k % 7 == 0 else 0.0
        ours.update(z, dt, is_stationary=remaining, temperature=warm, sigma=doubt)
        t, age = age + 0.5 * dt, age + dt
        gone = math.exp(-t / 300.0)
        course = 0.002 + 0.02 * (1.0 - gone) + 1e-4 * (warm - 25.0)
        h = [0.0, 1.0, 1.0 - gone, -0.02 * t / 300.0**2 * gone, warm - 25.0, *[1.0] * len(constants)]
        keep = np.exp(-dt / constants)
        fade = np.diag([*[1.0] * 5, *keep])
        theirs.predict(F=fade, Q=np.diag([0.0, k_walk**2 * dt, 0, 0, 0, *each * (1.0 - keep**2)]))
        if remaining:
            theirs.update(z - course, H=np.array([h]), R=n**2 / dt + doubt**2)
        else:
            turned = np.eye(count)
            turned[0] -= np.array(h) * dt
            read = np.zeros((count, count))
            read[0, 0] = n**2 * dt + (doubt * dt) ** 2
            theirs.predict(F=turned, Q=read)
            theirs.x[0, 0] += (z - course) * dt
        agree(ours, theirs.x, theirs.P, h, course)


def agree(ours, x, p, h, course=0.0):
    """Return heading and bias, and the sigma of both."""
    state = ours.state()
    assert (state.heading, state.bias) == pytest.approx((x[0, 0], course + h @ x[:, 0]), rel=1e-9, abs=1e-15)
    spread = math.sqrt(max(p[0, 0], 0.0)), math.sqrt(h @ p @ np.array(h))
    assert (state.sigma_heading, state.sigma_bias) == pytest.approx(spread, rel=1e-6, abs=1e-12)


def test_runs_processed_together_equal_single_runs():
    noise = BiasNoise(1e-3, 1e-4, 1e-5)
    rates = np.random.default_rng(9).normal(0.1, 0.01, (50, 3))
    together = HeadingFilter(MODEL, noise, shape=(3,))
    single = [HeadingFilter(MODEL, noise) for _ in range(3)]
    for k, row in enumerate(rates):
        together.update(row, 0.1, is_stationary=k < 20)
        for filter_, rate in zip(single, row.tolist(), strict=True):
            filter_.update(rate, 0.1, is_stationary=k < 20)
    ends = [filter_.state() for filter_ in single]
    assert together.state().heading == pytest.approx([float(end.heading) for end in ends], rel=1e-12)
    assert together.state().bias == pytest.approx([float(end.bias) for end in ends], rel=1e-12)


def test_a_standstill_after_the_drive_corrects_the_heading():
    """A drifting bias is known better with ten seconds of standstill before and after than before alone."""
    noise = BiasNoise(1e-4, rate_random_walk=1e-3)
    before, both = (HeadingFilter(WarmupModel(0.0), noise) for _ in range(2))
    for filter_ in (before, both):
        for k in range(1100):
            filter_.update(0.0, 0.1, is_stationary=k < 100)
    for _ in range(100):
        both.update(0.0, 0.1, is_stationary=True)
    # The integral of a Brownian bridge has a quarter of the variance of a random walk: K^2 T^3 / 12.
    assert both.state().sigma_heading / before.state().sigma_heading == pytest.approx(0.5, rel=0.02)


def test_a_parameter_that_the_model_has_not_is_refused():
    with pytest.raises(ValueError, match="tau"):
        HeadingFilter(MODEL, BiasNoise(1e-3, warmup={"tau": 1.0})).update(0.0, 0.1)
