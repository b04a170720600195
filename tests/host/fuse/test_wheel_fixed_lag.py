"""Smoothing of the wheel filter with several lags: sigma decreases and the last pose stays the same."""

import itertools

import numpy as np
import pytest

from accuracy import slip
from hubodo.fuse.wheel.filter import ALIGNMENT_WINDOWS
from hubodo.fuse.wheel.fixed_lag import smooth_with_lag
from hubodo.fuse.wheel.records import SlipSchedule
from hubodo.fuse.wheel.smoother import run_second_pass, smooth_whole_log
from hubodo.fuse.wheel.track import run_wheel_filter, track_from_poses
from hubodo.recording import Table
from wheel_runs import config, short_loop, tables


def test_smoothing_reduces_sigma_and_keeps_the_last_pose() -> None:
    drive = short_loop(9)
    forward, smoothed = (run_wheel_filter(config(drive), tables(drive), lag=value) for value in (0.0, np.inf))
    assert smoothed.track.x[-1] == pytest.approx(forward.track.x[-1], abs=1e-6)
    middle = len(forward.track.t) // 2
    assert smoothed.track.covariance[middle, 2, 2] <= forward.track.covariance[middle, 2, 2]
    for run in (forward, smoothed):
        # A pose belongs to the end of its window.
        assert run.report.duration == pytest.approx(run.track.t[-1] - run.track.t[0] + 0.1)
        assert run.report.end == run.track.t[-1]
    assert "smoothed" in smoothed.report.method
    assert "not causal" in smoothed.report.method


def test_a_lag_of_zero_is_the_filter_and_one_of_the_log_length_is_full_smoothing() -> None:
    drive = short_loop(9)
    settings, recorded = config(drive), tables(drive)
    forward, full = run_wheel_filter(settings, recorded), run_wheel_filter(settings, recorded, lag=np.inf)
    steps = run_wheel_filter(settings, recorded, lag=1.0).filter.recorded_steps
    assert steps is not None
    zero_lag = track_from_poses(smooth_with_lag(settings, steps, ALIGNMENT_WINDOWS, 0, SlipSchedule(2), {}))
    longest_lag = track_from_poses(
        smooth_with_lag(settings, steps, ALIGNMENT_WINDOWS, len(steps), SlipSchedule(2), {})
    )
    for name in ("t", "x", "y", "heading", "speed", "yaw_rate", "covariance"):
        np.testing.assert_array_equal(getattr(zero_lag, name), getattr(forward.track, name))
        np.testing.assert_allclose(
            getattr(longest_lag, name), getattr(full.track, name), rtol=1e-6, atol=1e-8
        )


def test_a_longer_lag_never_increases_the_heading_sigma_and_keeps_the_last_pose() -> None:
    drive = short_loop(9)
    settings, recorded = config(drive), tables(drive)
    tracks = [run_wheel_filter(settings, recorded, lag=lag).track for lag in (0.0, 0.5, 2.0, np.inf)]
    for shorter, longer in itertools.pairwise(tracks):
        assert np.all(longer.covariance[:, 2, 2] <= shorter.covariance[:, 2, 2] * (1.0 + 1e-6))
    middle = len(tracks[0].t) // 2
    assert tracks[2].covariance[middle, 2, 2] < 0.999 * tracks[0].covariance[middle, 2, 2]
    assert [tracks[2].x[-1], tracks[2].y[-1]] == pytest.approx([tracks[0].x[-1], tracks[0].y[-1]], abs=1e-6)


def test_the_terms_of_a_first_pass_without_slip_are_those_of_a_second_pass() -> None:
    drive = short_loop(9)
    run = run_wheel_filter(config(drive), tables(drive), lag=np.inf)
    core, steps = run.filter.core, run.filter.recorded_steps
    assert steps is not None and core.is_single_pass
    poses, terms = run_second_pass(core, steps, ALIGNMENT_WINDOWS)
    assert len(terms) == len(steps)
    second_pass = track_from_poses(smooth_whole_log(poses, terms, core.pose_columns))
    assert terms == []
    for name in ("x", "y", "heading", "speed", "yaw_rate"):
        np.testing.assert_array_equal(getattr(run.track, name), getattr(second_pass, name))


def test_a_slip_or_an_outage_needs_a_second_pass() -> None:
    slipping, names, _ = slip.make_drive(slip.CASES["two wheels, 1.5 s of double spin"], 100)
    assert not run_wheel_filter(config(slipping, names), tables(slipping)).filter.core.is_single_pass
    drive = short_loop(9)
    silent = {
        name: Table(
            {key: column[(table.t < 10.0) | (table.t > 12.0)] for key, column in table.columns.items()}
        )
        for name, table in tables(drive).items()
    }
    assert not run_wheel_filter(config(drive), silent).filter.core.is_single_pass
