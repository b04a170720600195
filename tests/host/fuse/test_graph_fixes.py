"""Preparation of fixes before the graph, and factors of a new kind of sensor."""

import numpy as np
import pytest

from example_factor import Gates
from generators import gnss_drives
from graph_drives import wiggly_path
from gtsam_oracle import solve_with_gtsam
from hubodo.errors import InputError
from hubodo.fuse.graph.batch import fuse_graph
from hubodo.fuse.graph.build import build_graph
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.fixes import Fixes, localise_fix, localise_fixes
from hubodo.fuse.graph.live import LiveGraph
from hubodo.fuse.graph.odometry_steps import StepNoise
from hubodo.fuse.graph.solver import solve_graph
from hubodo.fuse.projection import make_local_frame
from hubodo.fuse.track import Track

ROW = 3


def fixes(latitude=47.0, longitude=8.0, sigma=None, count=9):
    """Return fixes at 47° north, 8° east, one per second, with other values in row 4."""
    table = Fixes(np.arange(float(count)), np.full(count, 47.0), np.full(count, 8.0), np.full(count, 2.0))
    table.latitude_deg[ROW], table.longitude_deg[ROW] = latitude, longitude
    if sigma is not None:
        table.sigma[ROW] = sigma
    return table


@pytest.mark.parametrize(
    ("latitude", "longitude"),
    [
        (90.001, 8.0),
        (-90.001, 8.0),
        (47.0, 360.001),
        (47.0, -360.001),
        (np.nan, 8.0),
        (47.0, np.nan),
        (np.inf, 8.0),
        (47.0, -np.inf),
    ],
)
def test_fixes_that_are_not_on_earth_are_dropped_and_reported(latitude, longitude):
    result = localise_fixes(fixes(latitude, longitude), 0.0, 8.0, 5.0, True)
    assert result.input_row.tolist() == [0, 1, 2, 4, 5, 6, 7, 8]
    (text,) = result.warnings
    assert "1 of 9 fixes" in text
    assert "row 4 (t = 3.000 s)" in text
    assert "not on Earth" in text


@pytest.mark.parametrize(("latitude", "longitude"), [(90.0, 8.0), (-90.0, 8.0), (47.0, 188.0), (-47.0, 8.0)])
def test_a_fix_far_from_the_others_is_dropped(latitude, longitude):
    result = localise_fixes(fixes(latitude, longitude), 0.0, 8.0, 5.0, True)
    assert ROW not in result.input_row
    assert "from the others" in result.warnings[0]


@pytest.mark.parametrize("longitude", [8.0, 368.0 - 360.0, -352.0])
def test_longitudes_are_reduced_modulo_360_degrees(longitude):
    result = localise_fixes(fixes(47.0, longitude), 0.0, 8.0, 5.0, True)
    assert result.warnings == ()
    assert np.max(np.abs(result.position)) < 1e-3


@pytest.mark.parametrize("place", [(90.0, 0.0), (47.0, 360.0), (47.0, -360.0)])
def test_extreme_latitudes_and_longitudes_are_valid(place):
    latitude, longitude = np.full(4, place[0]), np.full(4, place[1])
    result = localise_fixes(Fixes(np.arange(4.0), latitude, longitude), 0.0, 3.0, 5.0, True)
    assert len(result.t) == 4


@pytest.mark.parametrize(
    ("sigma", "declared", "used"),
    [
        (2.0, True, 2.0),
        (2.0, False, 5.0),
        (np.nan, True, 5.0),
        (0.0, True, 5.0),
        (-1.0, True, 5.0),
        (1e-4, True, 0.005),
    ],
)
def test_an_invalid_sigma_is_replaced_by_the_configured_one(sigma, declared, used):
    result = localise_fixes(fixes(sigma=sigma), 0.0, 8.0, 5.0, declared)
    assert result.sigma[ROW] == used
    single_fix = Fixes(np.zeros(1), np.array([47.0]), np.array([8.0]), np.array([sigma]))
    live = localise_fix(
        single_fix, make_local_frame(47.0, 8.0), GraphConfig(use_declared_sigmas=declared), 1.0
    )
    assert live.sigma[0] == used


def test_fixes_outside_the_odometry_are_dropped_and_reported_beyond_two_seconds():
    result = localise_fixes(fixes(), 1.5, 6.5, 5.0, True)
    assert result.input_row.tolist() == [2, 3, 4, 5, 6]
    assert result.warnings == ()
    two_missed = localise_fixes(fixes(), 3.5, 20.0, 5.0, True)
    assert "2 of 9 fixes" in two_missed.warnings[0]
    assert "outside the odometry" in two_missed.warnings[0]
    with pytest.raises(InputError, match="outside the odometry"):
        localise_fixes(fixes(), 100.0, 200.0, 5.0, True)
    with pytest.raises(InputError, match="no fix in it"):
        localise_fixes(fixes(count=9).__class__(*np.zeros((3, 0))), 0.0, 1.0, 5.0, True)


def test_a_new_kind_of_factor_has_the_optimum_of_gtsam_and_is_reviewed():
    path = wiggly_path(np.random.default_rng(51))
    gates = Gates(np.array([4.05, 11.0]), np.array([1.0, 2.5]))
    # Contradictory gates have a single optimum where the odometry is accurate.
    drive = build_graph(path, [gates], GraphConfig(noise=StepNoise(along=0.005, sideways=0.005)))
    ours = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    poses, _, cost = solve_with_gtsam(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    assert cost == pytest.approx(ours.cost, rel=1e-8)
    assert np.max(np.abs(poses - ours.poses)) < 1e-4
    assert any("passed 2 times" in text for text in fuse_graph(path, None, None, None, [gates]).warnings)


def test_a_new_kind_of_factor_is_used_live():
    rng = np.random.default_rng([52, 46])
    drive = gnss_drives.drive(rng, gnss_drives.loop(rng, length=60.0), fix_hz=2.0)
    errors_and_sigmas = []
    for with_gates in (False, True):
        live, next_fix = LiveGraph(), 0
        for i, t in enumerate(drive.odo_t):
            live.add_odometry(t, drive.odo_x[i], drive.odo_y[i], drive.odo_heading[i])
            while drive.fix_t[next_fix] < t and next_fix < len(drive.fix_t) - 1:
                live.add_fix(
                    drive.fix_t[next_fix], drive.fix_latitude_deg[next_fix], drive.fix_longitude_deg[next_fix]
                )
                next_fix += 1
            state = live.state()
            if with_gates and state is not None and i % 50 == 0:
                _, oy = state.frame.to_local(*gnss_drives.geodetic(0.0, 0.0, *drive.origin))
                north = list(drive.truth(t + 0.05))[1] + oy
                live.add_samples(t + 0.05, Gates(np.array([t + 0.05]), np.array([float(north)])))
        state = live.state()
        _, oy = state.frame.to_local(*gnss_drives.geodetic(0.0, 0.0, *drive.origin))
        errors_and_sigmas.append(
            (abs(state.y - oy - list(drive.truth(state.t))[1]), np.sqrt(state.covariance[1, 1]))
        )
    assert errors_and_sigmas[1][1] < 0.5 * errors_and_sigmas[0][1]
    assert errors_and_sigmas[1][0] < 4.0 * errors_and_sigmas[1][1]


def test_invalid_odometry_raises_an_input_error():
    t = np.arange(3.0)
    with pytest.raises(InputError, match="increasing time"):
        fuse_graph(Track(t[::-1], t, t, t), None)
    with pytest.raises(InputError, match="not finite"):
        fuse_graph(Track(t, t, t * np.nan, t), None)
