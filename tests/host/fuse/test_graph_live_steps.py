"""The live graph step by step: start attempts, accepted samples, window contents, warnings."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from generators.gnss_drives import geodetic
from hubodo.fuse.graph import live
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.live import LiveGraph, LiveLimits, SampleStatus

START, SPEED, TURN = 0.6, 1.5, 0.2
CONFIG = GraphConfig(start_heading=START, gnss_sigma=0.1, inflate_sigmas=False, estimate_delay=False)


def pose(t):
    """Return the pose of the odometry on a steady left bend from the origin."""
    heading = TURN * t
    return SPEED / TURN * np.sin(heading), SPEED / TURN * (1.0 - np.cos(heading)), heading


class Drive:
    """A live graph fed up to a time; fixes lie on the bend, shifted by `shift_east`, m."""

    def __init__(self, limits=None, config=CONFIG):
        self.graph, self.t = LiveGraph(config, limits), 0.0
        assert self.graph.add_odometry(0.0, *pose(0.0)) is SampleStatus.INITIALISING

    def feed(self, until):
        """Feed ten poses a second and return the times of the graph's poses after each."""
        received = []
        while self.t < until - 0.05:
            self.t = round(self.t + 0.1, 1)
            received.append(self.graph.add_odometry(self.t, *pose(self.t)))
        return received

    def add_fix_on_bend(self, t, shift_east=0.0):
        x, y, _ = pose(t)
        position = (x + 1j * y) * np.exp(1j * START) + shift_east
        coordinates = geodetic(np.array([position.real]), np.array([position.imag]), 47.0, 8.0)
        return self.graph.add_fix(t, *(float(value[0]) for value in coordinates))

    def drive_with_fixes(self, *times, shift_east=0.0):
        """Feed each fix just before the odometry of its time."""
        for t in times:
            self.feed(t - 0.1)
            self.add_fix_on_bend(t, shift_east)
            self.feed(t)
        return self

    @property
    def window(self):
        return self.graph._running.window

    def warnings_with(self, text):
        return [line for line in self.graph.warnings if text in line]


@pytest.fixture
def running_drive():
    """Return a graph at 6 s with one fix per second."""
    return Drive().drive_with_fixes(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


def test_the_graph_starts_with_three_fixes_at_the_next_attempt():
    drive = Drive().drive_with_fixes(1.0, 2.0, 3.0)
    assert drive.graph.state() is None
    received = drive.feed(5.0)
    assert received[0] is SampleStatus.INITIALISING and received[-1] is SampleStatus.ACCEPTED
    state = drive.graph.state()
    x, y, heading = pose(drive.t)
    assert state.t == drive.t and state.last_fix_t == 3.0
    assert state.heading == pytest.approx(START + heading, abs=0.01)
    # The frame's origin is the middle fix.
    distance = complex(x, y) - complex(*pose(2.0)[:2])
    assert complex(state.x, state.y) == pytest.approx(distance * np.exp(1j * START), abs=0.05)


@pytest.mark.parametrize("retry", [2.0, 0.7])
def test_start_attempts_follow_the_retry_interval_from_the_second_pose_on(monkeypatch, retry):
    tries = []
    monkeypatch.setattr(
        live, "start_graph", lambda path, samples, *_: tries.append((path.t[-1], len(samples)))
    )
    drive = Drive(LiveLimits(retry_interval=retry, start_history=4.0))
    drive.drive_with_fixes(1.0, 2.0, 3.0, 4.0, 5.0, 6.0).feed(9.0)
    times = [t for t, _ in tries]
    assert times[0] == 0.1
    assert all(retry - 1e-6 < b - a < retry + 0.11 for a, b in pairwise(times))
    # A start uses the measurements of the last four seconds.
    for t, count in tries:
        assert count == pytest.approx(
            sum(t - 4.1 <= add_fix_on_bend <= t for add_fix_on_bend in range(1, 7)), abs=1
        )
    assert drive.graph._odometry._poses[0][0] > drive.t - 4.2


@pytest.mark.parametrize(("max_latency", "spacing"), [(2.0, 1.0), (0.5, 1.0), (1.0, 0.4)])
def test_without_fixes_poses_are_added_after_the_maximum_latency(max_latency, spacing):
    drive = Drive(
        LiveLimits(max_fix_latency=max_latency), replace(CONFIG, max_pose_spacing=spacing)
    ).drive_with_fixes(1.0, 2.0, 3.0, 4.0, 5.0)
    last = 5.0
    for t in np.arange(5.1, 12.0, 0.1):
        drive.feed(t)
        newest = drive.window.pose_t[-1]
        # As soon as the latency exceeds the maximum by one pose.
        assert drive.t - newest <= max_latency + spacing + 1e-6
        assert newest - last < spacing + 1e-6
        last = newest
    assert drive.t - last > max_latency - 0.1
    assert np.diff(drive.window.pose_t).max() < 1.5 * spacing + 1e-6
    state = drive.graph.state()
    assert state.t == drive.t and state.last_fix_t == 5.0


def test_poses_are_added_before_a_fix_long_after_the_last_pose(running_drive):
    running_drive.feed(7.4)
    running_drive.add_fix_on_bend(7.4)
    assert running_drive.window.pose_t[-2:].tolist() == [6.0, 7.4]
    running_drive.feed(8.9)
    assert running_drive.add_fix_on_bend(8.95) is SampleStatus.ACCEPTED
    running_drive.feed(9.0)
    assert running_drive.window.pose_t[-3:] == pytest.approx([7.4, 8.4, 8.95])


def test_the_window_holds_the_poses_of_its_lag():
    drive = Drive(LiveLimits(lag=4.0)).drive_with_fixes(*np.arange(1.0, 14.0))
    state_t = drive.window.pose_t
    assert state_t[-1] == 13.0 and state_t[0] == pytest.approx(9.0)
    assert len(drive.graph._history) == 13
    with_short_history = Drive(LiveLimits(lag=4.0, start_history=5.0)).drive_with_fixes(*np.arange(1.0, 14.0))
    assert [sample.t for sample in with_short_history.graph._history] == pytest.approx(np.arange(8.0, 14.0))
    assert with_short_history.graph._odometry._poses[0][0] == pytest.approx(8.0, abs=0.11)


def test_a_fix_is_accepted_until_the_graph_has_passed_its_time(running_drive):
    assert running_drive.add_fix_on_bend(6.0) is SampleStatus.TOO_LATE
    assert running_drive.add_fix_on_bend(6.0 + 5e-7) is SampleStatus.TOO_LATE
    assert running_drive.add_fix_on_bend(5.9) is SampleStatus.TOO_LATE
    running_drive.feed(6.5)
    assert running_drive.add_fix_on_bend(6.3) is SampleStatus.ACCEPTED
    assert running_drive.window.pose_t[-1] == 6.3


def test_fixes_ahead_of_the_odometry_wait_in_order_of_time(running_drive):
    for t in (6.45, 6.25, 6.65, 6.35):
        assert running_drive.add_fix_on_bend(t) is SampleStatus.ACCEPTED
    assert running_drive.window.pose_t[-1] == 6.0
    running_drive.feed(6.5)
    assert running_drive.window.pose_t[-4:].tolist() == [6.0, 6.25, 6.35, 6.45]
    running_drive.feed(6.7)
    assert running_drive.window.pose_t[-1] == 6.65


def test_the_first_of_two_simultaneous_fixes_is_used(running_drive):
    def count():
        return len(running_drive.window.graph.find_group(PositionFactors).pose_index)

    before, poses = count(), len(running_drive.window.pose_t)
    running_drive.add_fix_on_bend(6.25)
    running_drive.add_fix_on_bend(6.25 + 5e-7, shift_east=50.0)
    running_drive.feed(6.4)
    assert (count(), len(running_drive.window.pose_t)) == (before + 1, poses + 1)
    assert not running_drive.warnings_with("jumped")
    running_drive.add_fix_on_bend(6.45)
    running_drive.add_fix_on_bend(6.45 + 5e-6)
    running_drive.feed(6.6)
    assert count() == before + 3


@pytest.mark.parametrize(("gap", "is_reported"), [(1.9, False), (2.1, True)])
def test_the_return_of_fixes_is_reported_after_two_seconds(running_drive, gap, is_reported):
    running_drive.drive_with_fixes(6.0 + gap)
    lines = running_drive.warnings_with("fixes are used again")
    assert len(lines) == is_reported
    assert all(f"t = {6.0 + gap:.1f} s" in line for line in lines)


def test_fixes_that_jump_are_reported_once_each_time(running_drive):
    running_drive.drive_with_fixes(7.0, 8.0, shift_east=100.0)
    (line,) = running_drive.warnings_with("jumped")
    assert "a fix at t = 7.0 s jumped; fixes after t = 6.0 s are rejected" in line
    assert running_drive.graph.state().last_fix_t == 6.0
    running_drive.drive_with_fixes(9.0).drive_with_fixes(10.0, 11.0, shift_east=100.0)
    assert len(running_drive.warnings_with("jumped")) == 2
    assert len(running_drive.warnings_with("used again from t = 9.0")) == 1


def test_the_graph_restarts_after_rejecting_all_fixes_for_long_enough():
    drive = Drive(LiveLimits(restart_after=5.0, start_history=4.0)).drive_with_fixes(*np.arange(1.0, 7.0))
    drive.drive_with_fixes(*np.arange(7.0, 12.0), shift_east=100.0)
    assert not drive.warnings_with("restarts") and drive.graph._running is not None
    drive.feed(11.9)
    drive.add_fix_on_bend(12.0, shift_east=100.0)
    drive.feed(12.0)
    assert len(drive.warnings_with("rejected since t = 6.0 s; the graph restarts at 12.0 s")) == 1
    drive.feed(12.3)
    # The measurements for the restart agree with the present fixes.
    state = drive.graph.state()
    assert state is not None and state.last_fix_t == 12.0


def test_values_that_are_not_finite_are_invalid(running_drive):
    nan = float("nan")
    assert running_drive.graph.add_odometry(9.0, nan, 0.0, 0.0) is SampleStatus.INVALID
    assert running_drive.graph.add_odometry(6.0, 0.0, 0.0, 0.0) is SampleStatus.TOO_LATE
    assert running_drive.graph.add_heading(9.0, nan) is SampleStatus.INVALID
    assert running_drive.graph.add_heading(nan, 0.1) is SampleStatus.INVALID
    assert running_drive.graph.add_heading(9.0, 0.1) is SampleStatus.ACCEPTED
    for place in ((90.1, 8.0), (47.0, 360.1), (-90.1, 8.0), (47.0, -360.1)):
        assert running_drive.graph.add_fix(9.0, *place) is SampleStatus.INVALID
    assert running_drive.graph.add_fix(nan, 47.0, 8.0) is SampleStatus.INVALID
    assert running_drive.graph.add_fix(9.1, 47.0, 8.0, 0.3) is SampleStatus.ACCEPTED
