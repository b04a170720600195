"""The live graph: factors and solver of the batch over a sliding window, sample by sample."""

import numpy as np
import pytest
from scipy.stats import chi2

from generators import gnss_drives
from hubodo.fuse.graph import initialisation
from hubodo.fuse.graph.batch import Fixes, fuse_graph
from hubodo.fuse.graph.live import LiveGraph, LiveLimits, SampleStatus
from hubodo.fuse.graph.odometry_steps import StepNoise
from hubodo.fuse.track import Track
from repetitions import first_and_more


def run_live(drive, fixes, late=0.15, seconds=None, limits=None, headings=(), since=0.0):
    """Feed a drive to a live graph in order of arrival.

    Returns the times of the states from `since` on, their errors (T, 3), covariances (T, 3, 3), and the
    graph.
    """
    live, times, errors, covariances = LiveGraph(limits=limits), [], [], []
    fixes, headings = list(fixes), list(headings)
    for i, t in enumerate(drive.odo_t):
        if seconds is not None and t > seconds:
            break
        live.add_odometry(t, drive.odo_x[i], drive.odo_y[i], drive.odo_heading[i])
        while fixes and fixes[0][0] + late <= t:
            live.add_fix(*fixes.pop(0))
        while headings and headings[0][0] + late <= t:
            live.add_heading(*headings.pop(0))
        state = live.state() if t >= since else None
        if state is not None:
            ox, oy = state.frame.to_local(*gnss_drives.geodetic(0.0, 0.0, *drive.origin))
            x, y, heading = drive.truth(state.t)
            heading_error = np.mod(state.heading - heading + np.pi, 2.0 * np.pi) - np.pi
            times.append(state.t)
            errors.append([state.x - ox - x, state.y - oy - y, heading_error])
            covariances.append(state.covariance)
    return np.array(times), np.array(errors), np.array(covariances), live


def drive_and_fixes(seed, length=120.0, keep=None, jump=None, fix_hz=5.0):
    rng = np.random.default_rng([seed, 46])
    drive = gnss_drives.drive(rng, gnss_drives.loop(rng, length=length), fix_hz=fix_hz)
    jumped = np.zeros(len(drive.fix_t)) if jump is None else (drive.fix_t > jump[0]) & (drive.fix_t < jump[1])
    latitude, _ = gnss_drives.geodetic(0.0, 100.0 * jumped, drive.fix_latitude_deg, drive.fix_longitude_deg)
    rows = zip(drive.fix_t, latitude, drive.fix_longitude_deg, np.full(len(latitude), 5.0), strict=True)
    return drive, [row for row in rows if keep is None or keep(row[0])]


def test_the_graph_starts_once_the_heading_is_observable_and_reaches_the_newest_pose():
    drive, fixes = drive_and_fixes(1, length=60.0, fix_hz=3.0)
    t, error, _, live = run_live(drive, fixes)
    assert t[0] < 35.0
    assert np.sqrt(np.mean(error[:, :2] ** 2)) < 1.2
    assert t[-1] == drive.odo_t[-1]
    assert live.warnings == ()


def test_no_batch_is_solved_before_the_fixes_can_determine_the_heading(monkeypatch):
    drive, fixes = drive_and_fixes(7, length=40.0, fix_hz=2.0)
    batch_times = []

    def batch(path, *remaining):
        batch_times.append(path.t[-1])
        return fuse_graph(path, *remaining)

    monkeypatch.setattr(initialisation, "fuse_graph", batch)
    start_time, attempts = run_live(drive, fixes, seconds=30.0)[0][0], batch_times.copy()
    # The vehicle stands still for five seconds, and a heading is not observable on 3 m with fixes of 5 m.
    assert attempts[0] > 7.0
    batch_times.clear()
    monkeypatch.setattr(initialisation, "_MAX_SIGMA_RATIO_TO_START", np.inf)
    assert run_live(drive, fixes, seconds=30.0)[0][0] == start_time
    assert batch_times[-len(attempts) :] == attempts and len(batch_times) > len(attempts)


@pytest.mark.parametrize("lag", first_and_more(5.0, 60.0))
def test_the_live_error_agrees_with_its_covariance(lag):
    """The mean NEES of 5 drives, seeds 100 to 104, lies within the 99.9 % band of 3 dof.

    With a lag of 5 s nearly all information is in the marginal prior. Each start attempt solves a batch, so
    attempts are limited. `make accuracy` has longer drives.
    """
    nees = []
    for seed in range(100, 105):
        drive, fixes = drive_and_fixes(seed, length=40.0, fix_hz=2.0)
        limits = LiveLimits(lag=lag, retry_interval=6.0)
        _, error, covariance, _ = run_live(drive, fixes, limits=limits, since=drive.odo_t[-1])
        nees.append(error[-1] @ np.linalg.solve(covariance[-1], error[-1]))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * len(nees)) / len(nees)
    assert low < np.mean(nees) < high, f"{np.mean(nees):.2f}"


@pytest.mark.parametrize(("lag", "tolerance"), first_and_more((10.0, 0.3), (1e3, 0.05)))
def test_the_last_live_pose_equals_the_batch_solution(lag, tolerance):
    """The tolerance, in sigmas of the batch, is nearly zero for a full window and small for a short one.

    A short window has linearised marginalised poses before later measurements arrived.
    """
    drive, fixes = drive_and_fixes(2, fix_hz=2.0)
    state = run_live(drive, fixes, late=0.0, limits=LiveLimits(lag=lag), since=np.inf)[3].state()
    path = Track(drive.odo_t, drive.odo_x, drive.odo_y, drive.odo_heading)
    batch = fuse_graph(path, Fixes(*np.array(fixes).T))
    origin, frame = gnss_drives.geodetic(0.0, 0.0, *drive.origin), (state.frame, batch.frame)
    (ox, oy), (bx, by) = (each.to_local(*origin) for each in frame)
    error = np.array([state.x - ox, state.y - oy]) - [batch.track.x[-1] - bx, batch.track.y[-1] - by]
    assert np.hypot(*error) < tolerance * np.hypot(batch.track.sigma_x[-1], batch.track.sigma_y[-1])
    assert abs(state.heading - batch.track.heading[-1]) < tolerance * batch.track.sigma_heading[-1]
    for name in ("wheel_radius", "yaw_scale", "yaw_rate", "curvature"):
        ours, theirs = state.constants[name], batch.constants[name]
        assert ours.sigma == pytest.approx(theirs.sigma, rel=0.1)
        assert abs(ours.value - theirs.value) < tolerance * theirs.sigma


def test_the_noise_of_the_newest_odometry_enters_the_covariance_in_map_axes():
    """A step of a metre with sigma 0.2 m forward, 0.1 m left, and an inflation of half a metre."""
    drive, fixes = drive_and_fixes(1, length=40.0, fix_hz=2.0)
    live = LiveGraph()
    for t, x, y, heading in zip(drive.odo_t[:-30], drive.odo_x, drive.odo_y, drive.odo_heading, strict=False):
        live.add_odometry(t, x, y, heading)
        while fixes and fixes[0][0] <= t:
            live.add_fix(*fixes.pop(0))
    live._running.noise = StepNoise(along=0.2, sideways=0.1, heading=0.0, heading_per_distance=0.0)
    poses = []
    for dt, distance in ((0.01, 0.0), (0.02, 1.0)):
        live.add_odometry(
            t + dt,
            x + distance * np.cos(heading),
            y + distance * np.sin(heading),
            heading,
            0.25 * distance,
        )
        poses.append(live.state())
    before, after = poses
    transition = np.eye(3)
    transition[:2, 2] = [before.y - after.y, after.x - before.x]
    added = after.covariance - transition @ before.covariance @ transition.T
    cos, sin = np.cos(before.heading), np.sin(before.heading)
    rotation = np.array([[cos, -sin], [sin, cos]])
    assert abs(sin) > 0.5 and abs(cos) > 0.1, "seed 1: the heading must not be along a map axis"
    assert added[:2, :2] == pytest.approx(rotation @ np.diag([0.29, 0.26]) @ rotation.T, abs=1e-3)
    assert added[2] == pytest.approx(np.zeros(3), abs=1e-4)


def test_fixes_are_used_again_after_the_odometry_corrects_itself():
    """The odometry jumps back by 80 m with an inflation; without it the fixes appear to have jumped."""
    for inflation, fixes_used in ((6400.0, True), (0.0, False)):
        live = LiveGraph()
        drive, fixes = drive_and_fixes(1, length=200.0, fix_hz=2.0)
        waiting, previous_offset = list(fixes), None
        for i, t in enumerate(drive.odo_t):
            offset = 80.0 if t >= 30.0 else 0.0
            has_jumped = offset > 0.0 and previous_offset == 0.0
            previous_offset = offset
            live.add_odometry(
                t,
                drive.odo_x[i] - offset,
                drive.odo_y[i],
                drive.odo_heading[i],
                inflation if has_jumped else 0.0,
            )
            while waiting and waiting[0][0] + 0.15 <= t:
                live.add_fix(*waiting.pop(0))
            if t > 33.0:
                break
        assert (live.state().last_fix_t > 32.0) == fixes_used
        assert any("rejected" in line for line in live.warnings) != fixes_used


def test_a_jump_and_an_outage_are_bridged_and_reported():
    drive, fixes = drive_and_fixes(3, keep=lambda t: not 70.0 < t < 90.0, jump=(50.0, 58.0), fix_hz=2.0)
    t, error, covariance, live = run_live(drive, fixes, since=40.0)
    assert np.max(np.hypot(error[:, 0], error[:, 1])) < 5.0
    before, within = np.searchsorted(t, 69.0), np.searchsorted(t, 89.0)
    assert np.trace(covariance[within][:2, :2]) > np.trace(covariance[before][:2, :2])
    assert any("jumped" in text for text in live.warnings)
    assert any("are used again" in text for text in live.warnings)
    assert not any("restarts" in text for text in live.warnings), (
        "eight seconds of rejected fixes must not cause a restart"
    )


def test_fixes_rejected_for_long_restart_the_graph():
    drive, fixes = drive_and_fixes(5, jump=(40.0, 1e9), fix_hz=3.0)
    limits = LiveLimits(restart_after=20.0, start_history=15.0)
    t, *_, live = run_live(drive, fixes, seconds=85.0, limits=limits, since=50.0)
    assert any("restarts" in text for text in live.warnings)
    # The measurements for the restart are already available.
    assert np.diff(t).max() < 1.0
    state = live.state()
    x, y = state.frame.to_local(*gnss_drives.geodetic(0.0, 100.0, *drive.origin))
    tx, ty, _ = drive.truth(state.t)
    assert np.hypot(state.x - x - tx, state.y - y - ty) < 5.0


def test_a_heading_and_a_fix_at_the_same_time_are_both_used():
    """A receiver with two antennas gives a heading per second in addition to the fixes."""
    drive, fixes = drive_and_fixes(6, length=60.0, fix_hz=2.0)
    rng = np.random.default_rng(6)
    headings = [
        (row[0], true_heading(drive, row[0]) + 0.01 * rng.standard_normal(), 0.01) for row in fixes[::2]
    ]
    options = {"late": -0.15, "since": drive.odo_t[-1]}
    without_headings, with_headings = (
        run_live(drive, fixes, headings=each, **options)[2][-1] for each in ((), headings)
    )
    # The noise of the headings averages out; what stays is their offset, prior 0.03 rad, reduced by the
    # fixes.
    assert with_headings[2, 2] < 1.0 / (1.0 / without_headings[2, 2] + 0.03**-2)


def true_heading(drive, t):
    return float(list(drive.truth(t))[2])


def test_unusable_samples_are_refused_with_a_reason():
    drive, fixes = drive_and_fixes(4, fix_hz=2.0)
    *_, live = run_live(drive, fixes, seconds=60.0, since=np.inf)
    assert live.add_fix(30.0, 47.0, 8.0) is SampleStatus.TOO_LATE
    assert live.add_fix(61.0, 95.0, 8.0) is SampleStatus.INVALID
    assert live.add_fix(61.0, 47.0, 361.0) is SampleStatus.INVALID
    assert live.add_fix(61.0, float("nan"), 8.0) is SampleStatus.INVALID
    assert live.add_heading(float("inf"), 0.0) is SampleStatus.INVALID
    assert live.add_odometry(10.0, 0.0, 0.0, 0.0) is SampleStatus.TOO_LATE
    assert LiveGraph().add_fix(0.0, 47.0, 8.0) is SampleStatus.INITIALISING
    assert LiveGraph().state() is None
