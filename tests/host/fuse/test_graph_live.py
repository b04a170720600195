"""The live graph: the same factors as the batch, measurement by measurement."""

import numpy as np
import pytest

from generators import gnss_drives
from hubodo.fuse.graph.graph import Fixes, OdometryPath, fuse_graph

pytest.importorskip("gtsam")
pytest.importorskip("pyproj")

from hubodo.fuse.graph.live import LiveGraph, Outcome


def run(drive, fixes, late=0.15, seconds=None):
    """Feeds a drive in order of arrival; (T, 3) errors and (T, 3) sigmas at each state, their times, and
    the graph."""
    live, place, times, errors, sigmas = LiveGraph(), 0, [], [], []
    for i, t in enumerate(drive.odo_t):
        if seconds is not None and t > seconds:
            break
        live.odometry(t, drive.odo_x[i], drive.odo_y[i], drive.odo_heading[i])
        while place < len(fixes) and fixes[place][0] + late <= t:
            live.fix(*fixes[place])
            place += 1
        state = live.state()
        if state is not None:
            zero = np.zeros(1)
            ox, oy = state.frame.to_local(*gnss_drives.geodetic(zero, zero, *drive.origin))
            x, y, heading = drive.truth(state.t)
            turn = np.mod(state.heading - heading + np.pi, 2.0 * np.pi) - np.pi
            times.append(state.t)
            errors.append([state.x - ox[0] - x, state.y - oy[0] - y, turn])
            sigmas.append(np.sqrt(np.diag(state.covariance)))
    return np.array(times), np.array(errors), np.array(sigmas), live


def drive_and_fixes(seed, length=120.0, keep=None, jump=None):
    rng = np.random.default_rng([seed, 46])
    drive = gnss_drives.drive(rng, gnss_drives.loop(rng, length=length))
    latitude = drive.fix_latitude_deg.copy()
    if jump is not None:
        latitude[(drive.fix_t > jump[0]) & (drive.fix_t < jump[1])] += 100.0 / 111_000.0
    rows = list(zip(drive.fix_t, latitude, drive.fix_longitude_deg, np.full(len(latitude), 5.0), strict=True))
    return drive, [row for row in rows if keep is None or keep(row[0])]


def test_it_starts_when_the_heading_is_told_and_stays_within_its_sigmas():
    drive, fixes = drive_and_fixes(1)
    t, error, sigma, live = run(drive, fixes)
    assert t[0] < 35.0
    assert np.sqrt(np.mean(error[:, :2] ** 2)) < 1.2
    assert np.mean(np.abs(error) < 2.5 * sigma) > 0.9
    assert t[-1] == drive.odo_t[-1]
    assert live.warnings == ()


def test_its_end_is_near_the_batch_of_the_same_data():
    drive, fixes = drive_and_fixes(2)
    state = run(drive, fixes, late=0.0)[3].state()
    path = OdometryPath(drive.odo_t, drive.odo_x, drive.odo_y, drive.odo_heading)
    batch = fuse_graph(path, Fixes(*np.array(fixes).T))
    sigma = np.hypot(batch.track.sigma_x[-1], batch.track.sigma_y[-1])
    zero = np.zeros(1)
    ours = state.frame.to_local(*gnss_drives.geodetic(zero, zero, *drive.origin))
    theirs = batch.frame.to_local(*gnss_drives.geodetic(zero, zero, *drive.origin))
    # What the window forgot and did not linearise again is well below what is not known.
    assert np.hypot(state.x - ours[0][0] - batch.track.x[-1] + theirs[0][0],
                    state.y - ours[1][0] - batch.track.y[-1] + theirs[1][0]) < 0.5 * sigma  # fmt: skip
    assert state.constants["scale"].sigma == pytest.approx(batch.constants["scale"].sigma, rel=0.2)


def test_a_jump_and_an_outage_are_ridden_out_and_said():
    drive, fixes = drive_and_fixes(3, keep=lambda t: not 70.0 < t < 90.0, jump=(50.0, 58.0))
    t, error, sigma, live = run(drive, fixes)
    assert np.max(np.hypot(error[:, 0], error[:, 1])[t > 40.0]) < 5.0
    before, within = np.searchsorted(t, 69.0), np.searchsorted(t, 89.0)
    assert np.hypot(*sigma[within][:2]) > np.hypot(*sigma[before][:2])
    assert any("jumped" in text for text in live.warnings)
    assert any("count again" in text for text in live.warnings)


def test_what_cannot_be_used_is_refused_with_its_reason():
    drive, fixes = drive_and_fixes(4)
    *_, live = run(drive, fixes, seconds=60.0)
    assert live.fix(30.0, 47.0, 8.0) is Outcome.LATE
    assert live.fix(61.0, 95.0, 8.0) is Outcome.IMPOSSIBLE
    assert live.fix(61.0, float("nan"), 8.0) is Outcome.IMPOSSIBLE
    assert live.heading(float("inf"), 0.0) is Outcome.IMPOSSIBLE
    assert live.odometry(10.0, 0.0, 0.0, 0.0) is Outcome.LATE
    assert LiveGraph().fix(0.0, 47.0, 8.0) is Outcome.STARTING
    assert LiveGraph().state() is None
