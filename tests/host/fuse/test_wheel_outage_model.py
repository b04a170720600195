"""Outages and pauses of the wheel filter: consistency, constant time, live equal to bulk bit by bit."""

import gc
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from generators.outages import MEANWHILE, drive_with_outage, driven_during_outage, paused_drive
from hubodo.fuse.wheel.entries import HEADING, RATE_BEYOND_RANGE, SPEED, WHEEL_ANGLE, YAW_RATE, X, Y
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.free_motion import (
    UNIFORM_ANGLE_SIGMA,
    free_motion_variances,
    predict_free_motion,
    vehicle_motion_sigmas,
)
from hubodo.fuse.wheel.motion_model import HeadingErrorInflation
from hubodo.fuse.wheel.outage_model import OutageModel
from hubodo.fuse.wheel.state_vector import initial_state
from hubodo.fuse.wheel.track import run_wheel_filter, track_from_poses
from repetitions import first_and_more
from wheel_runs import config, pose_error, sample_columns, samples_in_time_order, tables, true_pose

SEED = 3
MAX_CPU_S = 2e-3
"""CPU time that one sample may take, s."""


def simulate_free_motion(speed, yaw_rate, seconds, motion_sigmas, seed=1, runs=6000, step=0.02):
    """Return forward, left, heading, speed and yaw rate, (runs, 5), simulated by Euler's method."""
    rng = np.random.default_rng(seed)
    v, r = np.full(runs, speed), np.full(runs, yaw_rate)
    x, y, heading = np.zeros((3, runs))
    for _ in range(round(seconds / step)):
        x, y, heading = x + v * np.cos(heading) * step, y + v * np.sin(heading) * step, heading + r * step
        v = v - v * step / 16.0 + motion_sigmas.speed * np.sqrt(2.0 * step / 16.0) * rng.standard_normal(runs)
        r = (
            r
            - r * step / 2.0
            + motion_sigmas.yaw_rate * np.sqrt(2.0 * step / 2.0) * rng.standard_normal(runs)
        )
    return np.column_stack([x, y, heading, v, r])


@pytest.mark.parametrize(
    ("speed", "yaw_rate", "seconds", "step"),
    first_and_more((1.2, -0.2, 12.0, 0.02), (1.2, 0.3, 3.0, 0.02), (0.0, 0.0, 100.0, 0.05)),
)
def test_mean_and_covariance_equal_a_monte_carlo_simulation(speed, yaw_rate, seconds, step):
    motion_sigmas = vehicle_motion_sigmas(1.0)
    motion = predict_free_motion(speed, yaw_rate, seconds, motion_sigmas)
    samples = simulate_free_motion(speed, yaw_rate, seconds, motion_sigmas, step=step)
    mean, covariance = samples.mean(axis=0), np.cov(samples.T)
    sigmas = np.sqrt(covariance.diagonal())
    assert (
        np.abs(mean[:2] - [motion.displacement.real, motion.displacement.imag]).max()
        < 0.06 * sigmas[:2].max()
    )
    assert mean[2] == pytest.approx(motion.heading_by_yaw_rate * yaw_rate, abs=0.06 * sigmas[2])
    # The heading sigma is capped at that of a uniform angle.
    heading_cap = min(1.0, UNIFORM_ANGLE_SIGMA / sigmas[2])
    scale = np.array([1.0, 1.0, heading_cap, 1.0, 1.0]) * sigmas
    expected = covariance / np.outer(sigmas, sigmas)
    np.testing.assert_allclose(motion.noise / np.outer(scale, scale), expected, atol=0.07)
    assert np.linalg.eigvalsh(motion.noise).min() > -1e-9


def test_a_missed_window_adds_the_variance_of_the_processes():
    """An Ornstein-Uhlenbeck process of sigma s and correlation time T adds s² (1 - exp(-2 t / T)) in t."""
    motion_sigmas = vehicle_motion_sigmas(1.0)
    variances = [
        sigma**2 * -np.expm1(-2.0 * 0.1 / correlation_time)
        for sigma, correlation_time in ((motion_sigmas.speed, 16.0), (motion_sigmas.yaw_rate, 2.0))
    ]
    assert free_motion_variances(motion_sigmas) == pytest.approx(variances, rel=0.06)


def test_path_derivatives_equal_central_differences():
    motion_sigmas, step = vehicle_motion_sigmas(1.0), 1e-5
    motion = predict_free_motion(1.2, 0.3, 5.0, motion_sigmas)
    by_speed = (
        predict_free_motion(1.2 + step, 0.3, 5.0, motion_sigmas).displacement
        - predict_free_motion(1.2 - step, 0.3, 5.0, motion_sigmas).displacement
    ) / (2 * step)
    by_rate = (
        predict_free_motion(1.2, 0.3 + step, 5.0, motion_sigmas).displacement
        - predict_free_motion(1.2, 0.3 - step, 5.0, motion_sigmas).displacement
    ) / (2 * step)
    assert motion.by_speed == pytest.approx(by_speed, abs=1e-8)
    assert motion.by_yaw_rate == pytest.approx(by_rate, abs=1e-8)


def advance_over_outage(values, sigmas, seconds, is_stationary=False):
    """Return (states, covariance, vehicle columns, initial state, (states, covariance) before) after an
    outage.

    values, sigmas: of x, y, heading, speed and yaw rate before it; all other states start at half of the
    prior. The heading variance that the model reports is checked as well.
    """
    drive, _, _ = paused_drive(SEED, 1.0)
    initial = initial_state(replace(config(drive), position_aided=True))
    x, p = list(initial.x), initial.p.copy()
    vehicle_columns = [initial.columns.vehicle[entry] for entry in (X, Y, HEADING, SPEED, YAW_RATE)]
    for column in range(len(x)):
        x[column] = 0.5 * np.sqrt(p[column, column])
    for column, value, sigma in zip(vehicle_columns, values, sigmas, strict=True):
        x[column], p[column, column] = value, sigma**2
    for wheel in initial.columns.wheels:
        for column in set(wheel.values()) - set(initial.columns.vehicle.values()):
            p[column, column] *= 0.25
    before = list(x), p.copy()
    speed, yaw_rate = (0.0, 0.0) if is_stationary else values[3:]
    _, heading_variance = OutageModel(config(drive), initial).advance(
        x, p, seconds, vehicle_motion_sigmas(1.0), is_stationary
    )
    assert heading_variance == pytest.approx(
        predict_free_motion(speed, yaw_rate, seconds, vehicle_motion_sigmas(1.0)).noise[2, 2], rel=1e-9
    )
    return np.array(x), p, vehicle_columns, initial, before


def test_prior_uncertainty_is_propagated_through_an_outage():
    """Compare with a Monte Carlo simulation whose vehicles start with that scatter."""
    heading, sigmas, rng = 0.8, np.array([0.3, 0.5, 0.05, 0.4, 0.1]), np.random.default_rng(SEED)
    x, p, columns, *_ = advance_over_outage([3.0, -2.0, heading, 1.2, 0.3], sigmas, 3.0)
    deviations = sigmas * rng.standard_normal((40_000, 5))
    samples = simulate_free_motion(
        1.2 + deviations[:, 3],
        0.3 + deviations[:, 4],
        3.0,
        vehicle_motion_sigmas(1.0),
        runs=len(deviations),
        step=0.05,
    )
    displacement = (samples[:, 0] + 1j * samples[:, 1]) * np.exp(1j * (heading + deviations[:, 2]))
    samples[:, 0], samples[:, 1] = (
        displacement.real + 3.0 + deviations[:, 0],
        displacement.imag - 2.0 + deviations[:, 1],
    )
    samples[:, 2] += heading + deviations[:, 2]
    sample_sigmas = samples.std(axis=0)
    assert np.abs((x[columns] - samples.mean(axis=0)) / sample_sigmas).max() < 0.06
    normalised = p[np.ix_(columns, columns)] / np.outer(sample_sigmas, sample_sigmas)
    np.testing.assert_allclose(
        normalised, np.cov(samples.T) / np.outer(sample_sigmas, sample_sigmas), atol=0.05
    )


def test_after_standstill_the_added_motion_is_uncorrelated_with_the_heading():
    sigmas = [0.3, 0.5, 0.05, 0.4, 0.1]
    x, p, columns, _, _ = advance_over_outage([3.0, -2.0, 0.8, 1.2, 0.3], sigmas, 20.0, is_stationary=True)
    assert x[columns].tolist() == [3.0, -2.0, 0.8, 0.0, 0.0]
    # A vehicle that starts from standstill may leave in any direction.
    heading_covariances = p[columns[2], [columns[0], columns[1], columns[3]]]
    assert heading_covariances.tolist() == [0.0, 0.0, 0.0]


def test_correlated_states_decay_and_random_walks_are_capped_at_their_prior():
    """A value decays by exp(-t / T), the excess of its variance over the prior by exp(-2 t / T)."""
    seconds = 450.0
    x, p, _, initial, (x0, p0) = advance_over_outage([0.0] * 5, [0.1] * 5, seconds)
    decaying = {
        entry: column
        for entry, column in initial.columns.vehicle.items()
        if np.isfinite(entry.correlation_time)
    }
    assert decaying
    for entry, column in decaying.items():
        decay = np.exp(-seconds / entry.correlation_time)
        assert x[column] == pytest.approx(decay * x0[column], rel=1e-9)
        expected = p0[column, column] * decay**2 + initial.p[column, column] * (1.0 - decay**2)
        assert p[column, column] == pytest.approx(expected, rel=1e-9)
    for column in initial.columns.wheels:
        assert x[column[WHEEL_ANGLE]] == x[column[RATE_BEYOND_RANGE]] == 0.0
        assert p[column[WHEEL_ANGLE], column[WHEEL_ANGLE]] == UNIFORM_ANGLE_SIGMA**2
    short_outage, long_outage = (advance_over_outage([0.0] * 5, [0.1] * 5, t) for t in (10.0, 1e12))
    n_random_walks = 0
    for column in initial.columns.wheels:
        for entry, walk_column in column.items():
            if (
                entry not in (WHEEL_ANGLE, RATE_BEYOND_RANGE)
                and walk_column not in initial.columns.vehicle.values()
            ):
                cap = max(entry.prior**2, initial.p[walk_column, walk_column])
                added = initial.walk_variances[walk_column] * 10.0
                assert short_outage[1][walk_column, walk_column] == pytest.approx(
                    min(p0[walk_column, walk_column] + added, cap), rel=1e-9
                )
                n_random_walks += added > 0.0
                assert long_outage[1][walk_column, walk_column] == pytest.approx(
                    cap if added else p0[walk_column, walk_column], rel=1e-9
                )
    assert n_random_walks


@pytest.mark.parametrize("sigma", [0.2, 1.0, 3.0])
def test_heading_error_inflation_covers_the_shortened_displacement(sigma):
    heading_errors = sigma * np.random.default_rng(2).standard_normal(400_000)
    mean_square = np.mean((1.0 - np.cos(heading_errors)) ** 2)
    inflation = HeadingErrorInflation()
    for fraction in (0.25, 0.5, 1.0):
        inflation.advance(3.0 * fraction, 4.0 * fraction, sigma**2)
    displacement = [3.0, 4.0, 0.0, 0.0, 0.0]
    assert inflation.covariance == pytest.approx(mean_square * np.outer(displacement, displacement), rel=0.02)


@pytest.mark.parametrize(("seconds", "min_sigma", "max_sigma"), [(3.0, 1.0, 5.0), (20.0, 10.0, 40.0)])
@pytest.mark.parametrize("seeds", first_and_more([SEED], [SEED, SEED + 1]), ids=str)
def test_after_an_outage_sigma_covers_the_motion_of_a_vehicle(seeds, seconds, min_sigma, max_sigma):
    """NEES over four kinds of driving, right after the outage and at the end."""
    nees_after, nees_end = [], []
    for meanwhile in MEANWHILE:
        for seed in seeds:
            drive, outage_end = drive_with_outage(seed, seconds, meanwhile)
            track = run_wheel_filter(config(drive), tables(drive)).track
            after_outage = int(np.searchsorted(track.t, outage_end))
            sigma = float(np.sqrt(np.trace(track.covariance[after_outage, :2, :2])))
            assert min_sigma < sigma < max_sigma, f"{meanwhile}, seed {seed}"
            for nees_values, pose_index in ((nees_after, after_outage), (nees_end, -1)):
                error, covariance = pose_error(drive, track, pose_index)
                nees_values.append(float(error @ np.linalg.solve(covariance, error)))
    print(f"{seconds:g} s, seeds {seeds}: NEES {np.mean(nees_after):.2f}, {np.mean(nees_end):.2f}")
    for nees_values in (nees_after, nees_end):
        assert 0.25 * 3.0 < np.mean(nees_values) < 2.0 * 3.0
        assert max(nees_values) < chi2.ppf(1.0 - 1e-4, 3)


@pytest.mark.parametrize("pause", first_and_more(7200.0, 0.9, 0.7, 2.5, 3 * 86400.0))
def test_a_pause_of_any_length_costs_no_cpu_time_and_live_equals_bulk_bit_by_bit(pause):
    """The heading is kept across the standstill; CPU time is the minimum per sample over up to three runs."""
    drive, _, end = paused_drive(SEED, pause, 24.0)
    cpu_start = time.process_time()
    bulk = run_wheel_filter(config(drive), tables(drive)).track
    assert time.process_time() - cpu_start < 5.0
    min_seconds = np.inf
    samples = samples_in_time_order(sample_columns(drive))
    gc.disable()
    try:
        for _ in range(3):
            # The clock is read once per sample, which takes as long as many samples do.
            live_filter, poses, ticks = WheelFilter(config(drive)), [], [time.process_time()]
            for sample in samples:
                poses += live_filter.handle(sample).poses
                ticks.append(time.process_time())
            # The minimum over the runs is the time of the computation without interruptions.
            min_seconds = np.minimum(min_seconds, np.diff(ticks))
            max_seconds = float(min_seconds.max())
            if max_seconds < MAX_CPU_S:
                break
    finally:
        gc.enable()
    live = track_from_poses([*poses, *live_filter.finish().poses])
    for name in ("t", "x", "y", "heading", "speed", "covariance"):
        assert getattr(live, name).tobytes() == getattr(bulk, name).tobytes(), name
    _, _, heading = true_pose(drive, drive.t[-1])
    heading_error = float(bulk.heading[-1] - heading)
    error_deg = np.degrees(heading_error)
    print(f"seed {SEED}, {pause:g} s: {1e3 * max_seconds:.2f} ms at most, heading error {error_deg:+.2f}°")
    assert max_seconds < MAX_CPU_S
    assert bulk.t[-1] == pytest.approx(end, abs=0.3)
    assert abs(heading_error) < 3.0 * np.sqrt(bulk.covariance[-1, 2, 2]) < 0.5
    assert len(bulk.t) < 10.0 * drive.t[-1] + 10


def test_a_stationary_pause_is_reported_and_the_position_sigma_grows():
    drive, pause_start, _ = paused_drive(SEED, 600.0)
    run = run_wheel_filter(config(drive), tables(drive))
    (outage,) = run.report.outages
    assert outage.was_stationary and outage.start == pytest.approx(pause_start, abs=0.2)
    assert outage.end == pytest.approx(pause_start + 600.0, abs=0.2)
    assert any("its heading is kept" in line and "600" in line for line in run.report.warnings)
    after_pause = np.searchsorted(run.track.t, pause_start + 602.0)
    assert 20.0 < np.sqrt(run.track.covariance[after_pause, 0, 0]) < 300.0
    assert run.report.distance == pytest.approx(drive.length, rel=0.02)


def test_wheels_turned_during_an_outage_do_not_keep_the_heading():
    """The vehicle was driven during the outage, from standstill to standstill."""
    drive, outage_end = driven_during_outage(SEED)
    run = run_wheel_filter(config(drive), tables(drive))
    assert [outage.was_stationary for outage in run.report.outages] == [False]
    after_outage = int(np.searchsorted(run.track.t, outage_end + 2.0))
    error, covariance = pose_error(drive, run.track, after_outage)
    assert np.sqrt(covariance[2, 2]) > 1.0
    assert error @ np.linalg.solve(covariance, error) < chi2.ppf(1.0 - 1e-3, 3)


def test_smoothing_across_an_outage_leaves_the_last_pose_unchanged():
    drive, outage_end = drive_with_outage(SEED, 3.0, "goes on")
    forward, smoothed = (run_wheel_filter(config(drive), tables(drive), lag).track for lag in (0.0, np.inf))
    np.testing.assert_allclose(smoothed.covariance[-1], forward.covariance[-1], rtol=1e-6, atol=1e-12)
    assert smoothed.x[-1] == pytest.approx(forward.x[-1], abs=1e-6)
    after_outage = int(np.searchsorted(forward.t, outage_end))
    for track in (forward, smoothed):
        error, covariance = pose_error(drive, track, after_outage)
        assert error @ np.linalg.solve(covariance, error) < chi2.ppf(1.0 - 1e-3, 3)


@pytest.mark.parametrize("seconds", [0.5, 4.0, 30.0, 55.0])
def test_free_motion_equals_the_closed_form_of_ornstein_uhlenbeck_processes(seconds):
    """Correlation times: 16 s for the speed, 2 s for the yaw rate, whose integral is the heading."""
    motion_sigmas = vehicle_motion_sigmas(1.0)
    motion = predict_free_motion(1.2, 0.3, seconds, motion_sigmas)
    assert (motion.speed_decay, motion.yaw_rate_decay) == pytest.approx(
        (np.exp(-seconds / 16.0), np.exp(-seconds / 2.0))
    )
    decay = np.exp(-seconds / 2.0)
    assert motion.heading_by_yaw_rate == pytest.approx(2.0 * (1.0 - decay))
    speed_variance, yaw_variance = motion_sigmas.speed**2, motion_sigmas.yaw_rate**2
    assert motion.noise[3, 3] == pytest.approx(-speed_variance * np.expm1(-2.0 * seconds / 16.0))
    assert motion.noise[4, 4] == pytest.approx(yaw_variance * (1.0 - decay**2))
    heading_variance = yaw_variance * 2.0**2 * (2.0 * seconds / 2.0 - 3.0 + 4.0 * decay - decay**2)
    cap = min(1.0, UNIFORM_ANGLE_SIGMA / np.sqrt(heading_variance))
    assert motion.noise[2, 2] == pytest.approx(heading_variance * cap**2)
    assert (
        motion.noise[2, 4]
        == motion.noise[4, 2]
        == pytest.approx(yaw_variance * 2.0 * (1.0 - decay) ** 2 * cap)
    )


@pytest.mark.parametrize(
    ("max_speed", "speed", "yaw_rate"),
    [(0.0, 2.0, 0.35), (1.3, 2.0, 0.35), (1.4, 2.1, 0.35), (10.0, 15.0, 3.0 / 15.0)],
)
def test_motion_sigmas_follow_the_largest_speed_but_is_at_least_that_of_walking(max_speed, speed, yaw_rate):
    assert vehicle_motion_sigmas(max_speed) == pytest.approx((speed, yaw_rate))
