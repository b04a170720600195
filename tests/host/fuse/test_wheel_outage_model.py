"""Silences and pauses of the wheel filter: honest sigmas, constant time, the same bits live."""

import gc
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from generators.outages import MEANWHILE, drive_with_outage, driven_during_outage, paused_drive
from hubodo.fuse.wheel.entries import HEADING, RATE_BEYOND_RANGE, SPEED, WHEEL_ANGLE, YAW_RATE, X, Y
from hubodo.fuse.wheel.filter import WheelFilter, WheelSample
from hubodo.fuse.wheel.heading_error_inflation import HeadingErrorInflation
from hubodo.fuse.wheel.initial_state import initial_state
from hubodo.fuse.wheel.outage_model import (
    UNIFORM_ANGLE_SIGMA,
    OutageModel,
    free_motion_variances,
    predict_free_motion,
    vehicle_agility,
)
from hubodo.fuse.wheel.track import run_wheel_filter, track_from_poses
from wheel_runs import config, pose_error, tables, truth

SEED = 3
S_CPU = 2e-3


def simulated(speed, yaw_rate, seconds, able, seed=1, runs=6000, step=0.02):
    """(runs, 5) forward, left, heading, speed, yaw rate of the processes, stepped by Euler's method."""
    rng = np.random.default_rng(seed)
    v, r = np.full(runs, speed), np.full(runs, yaw_rate)
    x, y, heading = np.zeros((3, runs))
    for _ in range(round(seconds / step)):
        x, y, heading = x + v * np.cos(heading) * step, y + v * np.sin(heading) * step, heading + r * step
        v = v - v * step / 16.0 + able.speed * np.sqrt(2.0 * step / 16.0) * rng.standard_normal(runs)
        r = r - r * step / 2.0 + able.yaw_rate * np.sqrt(2.0 * step / 2.0) * rng.standard_normal(runs)
    return np.column_stack([x, y, heading, v, r])


@pytest.mark.parametrize(
    ("speed", "yaw_rate", "seconds", "step"),
    [(1.2, 0.3, 3.0, 0.02), (1.2, -0.2, 12.0, 0.02), (0.0, 0.0, 100.0, 0.05)],
)
def test_mean_and_covariance_are_those_of_the_simulated_processes(speed, yaw_rate, seconds, step):
    able = vehicle_agility(1.0)
    found = predict_free_motion(speed, yaw_rate, seconds, able)
    made = simulated(speed, yaw_rate, seconds, able, step=step)
    mean, covariance = made.mean(axis=0), np.cov(made.T)
    spread = np.sqrt(covariance.diagonal())
    assert np.abs(mean[:2] - [found.path.real, found.path.imag]).max() < 0.06 * spread[:2].max()
    assert mean[2] == pytest.approx(found.turn * yaw_rate, abs=0.06 * spread[2])
    # A heading that is lost is no more than lost.
    lost = min(1.0, UNIFORM_ANGLE_SIGMA / spread[2])
    scale = np.array([1.0, 1.0, lost, 1.0, 1.0]) * spread
    expected = covariance / np.outer(spread, spread)
    np.testing.assert_allclose(found.noise / np.outer(scale, scale), expected, atol=0.07)
    assert np.linalg.eigvalsh(found.noise).min() > -1e-9


def test_a_window_that_is_not_seen_adds_what_the_processes_change_by_in_it():
    """An Ornstein-Uhlenbeck process of 1 sigma s forgets within T: s² (1 - exp(-2 t / T)) is new after t."""
    able = vehicle_agility(1.0)
    new = [
        sigma**2 * -np.expm1(-2.0 * 0.1 / forgets)
        for sigma, forgets in ((able.speed, 16.0), (able.yaw_rate, 2.0))
    ]
    assert free_motion_variances(able) == pytest.approx(new, rel=0.06)


def test_derivatives_of_the_way_are_its_differences():
    able, step = vehicle_agility(1.0), 1e-5
    found = predict_free_motion(1.2, 0.3, 5.0, able)
    by_speed = (
        predict_free_motion(1.2 + step, 0.3, 5.0, able).path
        - predict_free_motion(1.2 - step, 0.3, 5.0, able).path
    ) / (2 * step)
    by_rate = (
        predict_free_motion(1.2, 0.3 + step, 5.0, able).path
        - predict_free_motion(1.2, 0.3 - step, 5.0, able).path
    ) / (2 * step)
    assert found.by_speed == pytest.approx(by_speed, abs=1e-8)
    assert found.by_yaw_rate == pytest.approx(by_rate, abs=1e-8)


def carried(at, sigmas, seconds, stands=False):
    """(states, covariance, where each entry is, as they began) after a silence.

    at, sigmas: of x, y, heading, speed, yaw rate at its beginning; of all other states one half of the prior.
    The variance of the heading that is said to be new is what its motion makes.
    """
    drive, _, _ = paused_drive(SEED, 1.0)
    begin = initial_state(replace(config(drive), position_aided=True))
    x, p = list(begin.x), begin.p.copy()
    places = [begin.columns.vehicle[entry] for entry in (X, Y, HEADING, SPEED, YAW_RATE)]
    for place in range(len(x)):
        x[place] = 0.5 * np.sqrt(p[place, place])
    for place, value, sigma in zip(places, at, sigmas, strict=True):
        x[place], p[place, place] = value, sigma**2
    for wheel in begin.columns.wheels:
        for place in set(wheel.values()) - set(begin.columns.vehicle.values()):
            p[place, place] *= 0.25
    before = list(x), p.copy()
    speed, yaw_rate = (0.0, 0.0) if stands else at[3:]
    _, new = OutageModel(config(drive), begin).advance(x, p, seconds, vehicle_agility(1.0), stands)
    assert new == pytest.approx(
        predict_free_motion(speed, yaw_rate, seconds, vehicle_agility(1.0)).noise[2, 2], rel=1e-9
    )
    return np.array(x), p, places, begin, before


def test_what_was_unsure_before_a_silence_is_carried_through_it_in_axes_of_the_heading():
    """Beside many vehicles that begin with that scatter and go on as the processes do, by Euler's method."""
    heading, sigmas, rng = 0.8, np.array([0.3, 0.5, 0.05, 0.4, 0.1]), np.random.default_rng(SEED)
    x, p, places, *_ = carried([3.0, -2.0, heading, 1.2, 0.3], sigmas, 3.0)
    off = sigmas * rng.standard_normal((40_000, 5))
    made = simulated(1.2 + off[:, 3], 0.3 + off[:, 4], 3.0, vehicle_agility(1.0), runs=len(off), step=0.05)
    way = (made[:, 0] + 1j * made[:, 1]) * np.exp(1j * (heading + off[:, 2]))
    made[:, 0], made[:, 1] = way.real + 3.0 + off[:, 0], way.imag - 2.0 + off[:, 1]
    made[:, 2] += heading + off[:, 2]
    spread = made.std(axis=0)
    assert np.abs((x[places] - made.mean(axis=0)) / spread).max() < 0.06
    found = p[np.ix_(places, places)] / np.outer(spread, spread)
    np.testing.assert_allclose(found, np.cov(made.T) / np.outer(spread, spread), atol=0.05)


def test_of_a_vehicle_that_stood_all_that_may_have_become_new_is_kept_apart():
    sigmas = [0.3, 0.5, 0.05, 0.4, 0.1]
    x, p, places, _, _ = carried([3.0, -2.0, 0.8, 1.2, 0.3], sigmas, 20.0, stands=True)
    assert x[places].tolist() == [3.0, -2.0, 0.8, 0.0, 0.0]
    # From rest no way belongs to a turn, nor to what the heading was before.
    heading = p[places[2], [places[0], places[1], places[3]]]
    assert heading.tolist() == [0.0, 0.0, 0.0]


def test_what_fades_within_a_time_has_faded_and_what_wanders_ends_at_its_prior():
    """exp(-t / T) is left of a value, exp(-2 t / T) of what its variance had beyond that of the prior."""
    seconds = 450.0
    x, p, _, begin, (x0, p0) = carried([0.0] * 5, [0.1] * 5, seconds)
    fading = {entry: at for entry, at in begin.columns.vehicle.items() if np.isfinite(entry.correlation_time)}
    assert fading
    for entry, at in fading.items():
        left = np.exp(-seconds / entry.correlation_time)
        assert x[at] == pytest.approx(left * x0[at], rel=1e-9)
        known = p0[at, at] * left**2 + begin.p[at, at] * (1.0 - left**2)
        assert p[at, at] == pytest.approx(known, rel=1e-9)
    for at in begin.columns.wheels:
        assert x[at[WHEEL_ANGLE]] == x[at[RATE_BEYOND_RANGE]] == 0.0
        assert p[at[WHEEL_ANGLE], at[WHEEL_ANGLE]] == UNIFORM_ANGLE_SIGMA**2
    soon, late = (carried([0.0] * 5, [0.1] * 5, t) for t in (10.0, 1e12))
    wandered = 0
    for at in begin.columns.wheels:
        for entry, place in at.items():
            if entry not in (WHEEL_ANGLE, RATE_BEYOND_RANGE) and place not in begin.columns.vehicle.values():
                most = max(entry.prior**2, begin.p[place, place])
                added = begin.walk_variances[place] * 10.0
                assert soon[1][place, place] == pytest.approx(min(p0[place, place] + added, most), rel=1e-9)
                wandered += added > 0.0
                assert late[1][place, place] == pytest.approx(most if added else p0[place, place], rel=1e-9)
    assert wandered


@pytest.mark.parametrize("sigma", [0.2, 1.0, 3.0])
def test_a_way_in_an_unsure_direction_falls_short_by_what_is_added(sigma):
    off = sigma * np.random.default_rng(2).standard_normal(400_000)
    short = np.mean((1.0 - np.cos(off)) ** 2)
    made = HeadingErrorInflation()
    for share in (0.25, 0.5, 1.0):
        made.advance(3.0 * share, 4.0 * share, sigma**2)
    assert made.covariance == pytest.approx(short * np.outer([3.0, 4.0], [3.0, 4.0]), rel=0.02)


@pytest.mark.parametrize(("seconds", "least", "most"), [(3.0, 1.0, 5.0), (20.0, 10.0, 40.0)])
def test_after_a_silence_the_sigma_is_what_a_vehicle_can_do(seconds, least, most):
    """NEES over four kinds of driving on and two seeds each, after the silence and at the end."""
    soon, late = [], []
    for meanwhile in MEANWHILE:
        for seed in range(SEED, SEED + 2):
            drive, heard = drive_with_outage(seed, seconds, meanwhile)
            track = run_wheel_filter(config(drive), tables(drive)).track
            place = int(np.searchsorted(track.t, heard))
            sigma = float(np.sqrt(np.trace(track.covariance[place, :2, :2])))
            assert least < sigma < most, f"{meanwhile}, seed {seed}"
            for found, at in ((soon, place), (late, -1)):
                error, covariance = pose_error(drive, track, at)
                found.append(float(error @ np.linalg.solve(covariance, error)))
    print(
        f"{seconds:g} s, seeds {SEED}..{SEED + 1}: NEES of 3: {np.mean(soon):.2f}, {np.mean(late):.2f} late"
    )
    for found in (soon, late):
        assert 0.25 * 3.0 < np.mean(found) < 2.0 * 3.0
        assert max(found) < chi2.ppf(1.0 - 1e-4, 3)


def stream(drive):
    """The samples of all nodes in order of time."""
    samples = [
        WheelSample(name, t, tuple(gyro), tuple(accel))
        for name, node in drive.nodes.items()
        for t, gyro, accel in zip(node.t.tolist(), node.gyro.tolist(), node.accel.tolist(), strict=True)
    ]
    return sorted(samples, key=lambda sample: sample.t)


@pytest.mark.parametrize("pause", [0.7, 0.9, 2.5, 600.0, 7200.0, 3 * 86400.0])
def test_a_pause_takes_no_time_and_gives_the_bits_of_the_whole_log_live(pause):
    """The heading is kept where the vehicle stood; the most that a call costs, of three runs at most."""
    drive, _, end = paused_drive(SEED, pause, 24.0)
    begin = time.process_time()
    bulk = run_wheel_filter(config(drive), tables(drive)).track
    assert time.process_time() - begin < 5.0
    least = np.inf
    samples = stream(drive)
    gc.disable()
    try:
        for _ in range(3):
            # The clock is read once a sample: that takes as long as many samples do.
            made, poses, ticks = WheelFilter(config(drive)), [], [time.process_time()]
            for sample in samples:
                poses += made.handle(sample).poses
                ticks.append(time.process_time())
            # What one run took for a sample, no other makes more.
            least = np.minimum(least, np.diff(ticks))
            worst = float(least.max())
            if worst < S_CPU:
                break
    finally:
        gc.enable()
    live = track_from_poses([*poses, *made.finish().poses])
    for name in ("t", "x", "y", "heading", "speed", "covariance"):
        assert getattr(live, name).tobytes() == getattr(bulk, name).tobytes(), name
    _, _, heading = truth(drive, drive.t[-1])
    off = float(bulk.heading[-1] - heading)
    print(f"seed {SEED}, {pause:g} s: {1e3 * worst:.2f} ms at most, heading {np.degrees(off):+.2f}° off")
    assert worst < S_CPU
    assert bulk.t[-1] == pytest.approx(end, abs=0.3)
    assert abs(off) < 3.0 * np.sqrt(bulk.covariance[-1, 2, 2]) < 0.5
    assert len(bulk.t) < 10.0 * drive.t[-1] + 10


def test_a_pause_in_which_the_vehicle_stood_is_told_and_its_position_is_as_far_as_it_can_go():
    drive, begin, _ = paused_drive(SEED, 600.0)
    found = run_wheel_filter(config(drive), tables(drive))
    (silence,) = found.report.outages
    assert silence.was_stationary and silence.start == pytest.approx(begin, abs=0.2)
    assert silence.end == pytest.approx(begin + 600.0, abs=0.2)
    assert any("its heading is kept" in line and "600" in line for line in found.report.warnings)
    after = np.searchsorted(found.track.t, begin + 602.0)
    assert 20.0 < np.sqrt(found.track.covariance[after, 0, 0]) < 300.0
    assert found.report.distance == pytest.approx(drive.length, rel=0.02)


def test_wheels_that_stand_otherwise_after_a_pause_do_not_keep_the_heading():
    """It was driven on while nothing was heard, from rest to rest."""
    drive, heard = driven_during_outage(SEED)
    found = run_wheel_filter(config(drive), tables(drive))
    assert [silence.was_stationary for silence in found.report.outages] == [False]
    place = int(np.searchsorted(found.track.t, heard + 2.0))
    error, covariance = pose_error(drive, found.track, place)
    assert np.sqrt(covariance[2, 2]) > 1.0
    assert error @ np.linalg.solve(covariance, error) < chi2.ppf(1.0 - 1e-3, 3)


def test_smoothing_goes_over_a_silence_and_ends_as_the_filter():
    drive, heard = drive_with_outage(SEED, 3.0, "goes on")
    plain, smooth = (run_wheel_filter(config(drive), tables(drive), lag).track for lag in (0.0, np.inf))
    np.testing.assert_allclose(smooth.covariance[-1], plain.covariance[-1], rtol=1e-6, atol=1e-12)
    assert smooth.x[-1] == pytest.approx(plain.x[-1], abs=1e-6)
    place = int(np.searchsorted(plain.t, heard))
    for track in (plain, smooth):
        error, covariance = pose_error(drive, track, place)
        assert error @ np.linalg.solve(covariance, error) < chi2.ppf(1.0 - 1e-3, 3)


@pytest.mark.parametrize("seconds", [0.5, 4.0, 30.0, 55.0])
def test_speed_and_yaw_rate_forget_and_the_heading_is_the_integral_of_the_yaw_rate(seconds):
    """In closed form, of Ornstein-Uhlenbeck processes of 16 and 2 s."""
    able = vehicle_agility(1.0)
    found = predict_free_motion(1.2, 0.3, seconds, able)
    assert (found.speed, found.yaw_rate) == pytest.approx((np.exp(-seconds / 16.0), np.exp(-seconds / 2.0)))
    left = np.exp(-seconds / 2.0)
    assert found.turn == pytest.approx(2.0 * (1.0 - left))
    v, r = able.speed**2, able.yaw_rate**2
    assert found.noise[3, 3] == pytest.approx(-v * np.expm1(-2.0 * seconds / 16.0))
    assert found.noise[4, 4] == pytest.approx(r * (1.0 - left**2))
    heading = r * 2.0**2 * (2.0 * seconds / 2.0 - 3.0 + 4.0 * left - left**2)
    lost = min(1.0, UNIFORM_ANGLE_SIGMA / np.sqrt(heading))
    assert found.noise[2, 2] == pytest.approx(heading * lost**2)
    assert found.noise[2, 4] == found.noise[4, 2] == pytest.approx(r * 2.0 * (1.0 - left) ** 2 * lost)


@pytest.mark.parametrize(
    ("fastest", "speed", "yaw_rate"),
    [(0.0, 2.0, 0.35), (1.3, 2.0, 0.35), (1.4, 2.1, 0.35), (10.0, 15.0, 2.0 / 15.0)],
)
def test_a_vehicle_is_as_agile_as_it_was_seen_to_be_and_no_less_than_one_that_walks(fastest, speed, yaw_rate):
    assert vehicle_agility(fastest) == pytest.approx((speed, yaw_rate))
