"""Heading filter with a warm-up model: equal to filterpy, errors consistent with sigma."""

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from generators import start_gyro as start
from hubodo.effects.warmup import WarmupModel
from hubodo.fuse.heading_filter import BiasNoise, HeadingFilter

DEG = math.pi / 180.0
MODEL = WarmupModel(start.C2 * DEG, start.C1 * DEG, start.T)


def run_cases(case, seeds):
    """Return the errors, (M, 6000) in degrees, of the filter and of a plain mean, and the last state."""
    runs = [start.run(case, np.random.default_rng(seed)) for seed in seeds]
    measured = np.array([samples for _, samples, _ in runs])
    noise = BiasNoise(start.NOISE * DEG * math.sqrt(start.DT))
    heading_filter = HeadingFilter(MODEL, noise, age=start.AGES[case], shape=(len(runs),))
    heading = []
    for k, values in enumerate(measured.T):
        heading_filter.update(values * DEG, start.DT, is_stationary=k < start.AVERAGED)
        heading.append(heading_filter.state().heading)
    truth = np.cumsum([rate[start.AVERAGED :] for rate, _, _ in runs], axis=1) * start.DT
    corrected = measured[:, start.AVERAGED :] - measured[:, : start.AVERAGED].mean(axis=1)[:, None]
    mean = np.cumsum(corrected, axis=1) * start.DT - truth
    return np.array(heading[start.AVERAGED :]).T / DEG - truth, mean, heading_filter.state()


@pytest.mark.parametrize("case", start.DRIFTS_DEG)
def test_the_error_is_near_the_lower_bound_and_agrees_with_the_sigma(case):
    """The lower bound is the white noise averaged at standstill; the mean of a cold gyro contains its
    warm-up.
    """
    seeds = range(16)
    errors, mean, state = run_cases(case, seeds)
    end_errors, sigma = errors[:, -1], state.sigma_heading / DEG
    bound = start.NOISE / math.sqrt(start.AVERAGED) * start.RUN * start.DT
    rms = np.sqrt(np.mean(end_errors**2))
    print(f"{case}, {seeds}: rms {rms:.2f} deg, sigma {sigma:.2f}, bound {bound:.2f}")
    mean_rms = np.sqrt(np.mean(mean[:, -1] ** 2))
    assert rms < (1.1 if case == "warmed up" else 0.5) * mean_rms
    assert bound < sigma < 2 * bound
    # Chi-square with 16 dof lies between 3.9 and 38 in 99.8 % of cases.
    assert 3.9 < np.sum((end_errors / sigma) ** 2) < 38


def test_a_step_of_the_rate_does_not_cause_an_error_peak():
    errors, _, _ = run_cases("random rates", [3])
    parts = errors[0].reshape(10, -1)
    jumps = np.abs(parts[1:, :100] - parts[:-1, -1:]).max()
    # Five seconds of white noise: 0.2 deg/s sqrt(0.05 s 5 s) = 0.1 deg, and the drift of the bias.
    assert jumps < 0.6


def test_with_two_states_the_filter_equals_filterpy():
    noise, dt, walk = 0.01, 0.1, 0.001
    ours = HeadingFilter(
        WarmupModel(0.0), BiasNoise(noise * math.sqrt(dt), rate_random_walk=walk, offset=0.1)
    )
    theirs = KalmanFilter(2, 1, dim_u=1)
    theirs.x, theirs.P = np.zeros((2, 1)), np.diag([0.0, 0.1**2])
    theirs.H, theirs.R = np.array([[0.0, 1.0]]), np.array([[noise**2]])
    # The bias is propagated before the sample, and the heading uses the propagated bias.
    bias_noise, transition = np.diag([0.0, walk**2 * dt]), np.array([[1.0, -dt], [0.0, 1.0]])
    rng = np.random.default_rng(5)
    for k in range(300):
        z, is_stationary = rng.normal(0.02, noise), k % 100 < 60
        ours.update(z, dt, is_stationary=is_stationary)
        theirs.predict(F=np.eye(2), Q=bias_noise)
        if is_stationary:
            theirs.update(z)
        else:
            heading_noise = np.diag([(noise * dt) ** 2, 0.0])
            theirs.predict(u=np.array([[z]]), B=np.array([[dt], [0.0]]), F=transition, Q=heading_noise)
        assert_same_estimates(ours, theirs.x, theirs.P, [0.0, 1.0])


def test_with_warm_up_errors_and_flicker_the_filter_equals_filterpy():
    """All states (offset, c1, T, temperature, Markov processes) with uneven sample intervals."""
    model = WarmupModel(0.002, 0.02, 300.0, temperature_coefficient=1e-4)
    sigmas = {"c1": 0.004, "time_constant": 40.0, "temperature_coefficient": 3e-5}
    n, b, k_walk = 1e-3, 2e-3, 1e-5
    ours = HeadingFilter(model, BiasNoise(n, b, k_walk, 0.01, sigmas), age=20.0)
    # Time constants of 1, 5, 25, .. s up to 1e5 s, B^2 ln 5 / pi each.
    constants = 5.0 ** np.arange(8)
    count = 5 + len(constants)
    theirs = KalmanFilter(count, 1)
    variance_each = b**2 * math.log(5.0) / math.pi
    theirs.x = np.zeros((count, 1))
    theirs.P = np.diag([0.0, 0.01**2, 0.004**2, 40.0**2, 3e-5**2, *[variance_each] * len(constants)])
    rng, age = np.random.default_rng(8), 20.0
    for k in range(200):
        dt, temperature = rng.uniform(0.5, 2.0), rng.uniform(20.0, 30.0)
        z, is_stationary, extra_sigma = rng.normal(0.02, 0.01), k % 100 < 40, 0.003 if k % 7 == 0 else 0.0
        ours.update(z, dt, is_stationary=is_stationary, temperature=temperature, sigma=extra_sigma)
        t, age = age + 0.5 * dt, age + dt
        decay = math.exp(-t / 300.0)
        model_bias = 0.002 + 0.02 * (1.0 - decay) + 1e-4 * (temperature - 25.0)
        h = [0.0, 1.0, 1.0 - decay, -0.02 * t / 300.0**2 * decay, temperature - 25.0, *[1.0] * len(constants)]
        decays = np.exp(-dt / constants)
        bias_transition = np.diag([*[1.0] * 5, *decays])
        theirs.predict(
            F=bias_transition, Q=np.diag([0.0, k_walk**2 * dt, 0, 0, 0, *variance_each * (1.0 - decays**2)])
        )
        if is_stationary:
            theirs.update(z - model_bias, H=np.array([h]), R=n**2 / dt + extra_sigma**2)
        else:
            transition = np.eye(count)
            transition[0] -= np.array(h) * dt
            heading_noise = np.zeros((count, count))
            heading_noise[0, 0] = n**2 * dt + (extra_sigma * dt) ** 2
            theirs.predict(F=transition, Q=heading_noise)
            theirs.x[0, 0] += (z - model_bias) * dt
        assert_same_estimates(ours, theirs.x, theirs.P, h, model_bias)


def assert_same_estimates(ours, x, p, h, model_bias=0.0):
    """Assert that heading, bias and their sigmas equal those of filterpy."""
    state = ours.state()
    assert (state.heading, state.bias) == pytest.approx(
        (x[0, 0], model_bias + h @ x[:, 0]), rel=1e-9, abs=1e-15
    )
    sigmas = math.sqrt(max(p[0, 0], 0.0)), math.sqrt(h @ p @ np.array(h))
    assert (state.sigma_heading, state.sigma_bias) == pytest.approx(sigmas, rel=1e-6, abs=1e-12)


def test_runs_processed_together_equal_single_runs():
    noise = BiasNoise(1e-3, 1e-4, 1e-5)
    rates = np.random.default_rng(9).normal(0.1, 0.01, (50, 3))
    vectorised = HeadingFilter(MODEL, noise, shape=(3,))
    single = [HeadingFilter(MODEL, noise) for _ in range(3)]
    for k, row in enumerate(rates):
        vectorised.update(row, 0.1, is_stationary=k < 20)
        for filter_, rate in zip(single, row.tolist(), strict=True):
            filter_.update(rate, 0.1, is_stationary=k < 20)
    ends = [filter_.state() for filter_ in single]
    assert vectorised.state().heading == pytest.approx([float(end.heading) for end in ends], rel=1e-12)
    assert vectorised.state().bias == pytest.approx([float(end.bias) for end in ends], rel=1e-12)


def test_a_standstill_after_the_drive_corrects_the_heading():
    """Ten seconds of standstill before and after the drive determine a drifting bias better than before
    alone.
    """
    noise = BiasNoise(1e-4, rate_random_walk=1e-3)
    standstill_before, standstill_around = (HeadingFilter(WarmupModel(0.0), noise) for _ in range(2))
    for filter_ in (standstill_before, standstill_around):
        for k in range(1100):
            filter_.update(0.0, 0.1, is_stationary=k < 100)
    for _ in range(100):
        standstill_around.update(0.0, 0.1, is_stationary=True)
    # The integral of a Brownian bridge has a quarter of the variance of a random walk: K^2 T^3 / 12.
    assert standstill_around.state().sigma_heading / standstill_before.state().sigma_heading == pytest.approx(
        0.5, rel=0.02
    )


def test_an_unknown_warm_up_parameter_is_refused():
    with pytest.raises(ValueError, match="tau"):
        HeadingFilter(MODEL, BiasNoise(1e-3, warmup={"tau": 1.0})).update(0.0, 0.1)
