"""Smoothing of the wheel filter: what a lag gives, and that it ends where the filter does."""

import itertools

import numpy as np
import pytest

from hubodo.fuse.wheel.filter import ALIGNMENT_WINDOWS
from hubodo.fuse.wheel.fixed_lag import smooth_with_lag
from hubodo.fuse.wheel.slip_schedule import SlipSchedule
from hubodo.fuse.wheel.track import run_wheel_filter, track_from_poses
from wheel_runs import config, short, tables


def test_smoothing_lowers_the_error_along_the_way_and_keeps_the_end() -> None:
    drive = short(9)
    plain, smooth = (run_wheel_filter(config(drive), tables(drive), lag=value) for value in (0.0, np.inf))
    assert smooth.track.x[-1] == pytest.approx(plain.track.x[-1], abs=1e-6)
    middle = len(plain.track.t) // 2
    assert smooth.track.covariance[middle, 2, 2] <= plain.track.covariance[middle, 2, 2]
    for found in (plain, smooth):
        # A pose stands at the end of its window.
        assert found.report.duration == pytest.approx(found.track.t[-1] - found.track.t[0] + 0.1)
        assert found.report.end == found.track.t[-1]
    assert "smoothed" in smooth.report.method
    assert "not causal" in smooth.report.method


def test_a_lag_as_long_as_the_log_is_the_whole_log_and_no_lag_is_the_filter() -> None:
    drive = short(9)
    settings, recorded = config(drive), tables(drive)
    plain, whole = run_wheel_filter(settings, recorded), run_wheel_filter(settings, recorded, lag=np.inf)
    steps = run_wheel_filter(settings, recorded, lag=1.0).filter.recorded_steps
    assert steps is not None
    as_it_was = track_from_poses(smooth_with_lag(settings, steps, ALIGNMENT_WINDOWS, 0, SlipSchedule(2)))
    as_whole = track_from_poses(
        smooth_with_lag(settings, steps, ALIGNMENT_WINDOWS, len(steps), SlipSchedule(2))
    )
    for name in ("t", "x", "y", "heading", "speed", "yaw_rate", "covariance"):
        np.testing.assert_array_equal(getattr(as_it_was, name), getattr(plain.track, name))
        np.testing.assert_allclose(getattr(as_whole, name), getattr(whole.track, name), rtol=1e-6, atol=1e-8)


def test_a_longer_lag_never_makes_the_heading_less_sure_and_ends_as_the_filter() -> None:
    drive = short(9)
    settings, recorded = config(drive), tables(drive)
    tracks = [run_wheel_filter(settings, recorded, lag=lag).track for lag in (0.0, 0.5, 2.0, 8.0, np.inf)]
    for shorter, longer in itertools.pairwise(tracks):
        assert np.all(longer.covariance[:, 2, 2] <= shorter.covariance[:, 2, 2] * (1.0 + 1e-6))
    middle = len(tracks[0].t) // 2
    assert tracks[2].covariance[middle, 2, 2] < 0.999 * tracks[0].covariance[middle, 2, 2]
    assert [tracks[2].x[-1], tracks[2].y[-1]] == pytest.approx([tracks[0].x[-1], tracks[0].y[-1]], abs=1e-6)
