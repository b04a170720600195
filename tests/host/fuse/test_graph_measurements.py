"""What is measured outside on its way into the graph: which fixes are usable, and a kind that is new."""

from dataclasses import dataclass

import numpy as np
import pytest

from generators import gnss_drives
from graph_drives import wiggly_path
from gtsam_oracle import solve_with_gtsam
from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.graph.batch import fuse_graph
from hubodo.fuse.graph.build import build_graph
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.factor import FactorGroup, LinearisedFactors
from hubodo.fuse.graph.fixes import Fixes, localise_fix, localise_fixes
from hubodo.fuse.graph.live import LiveGraph
from hubodo.fuse.graph.odometry_steps import StepNoise
from hubodo.fuse.graph.solver import solve_graph
from hubodo.fuse.projection import make_local_frame
from hubodo.fuse.track import Track

ROW = 3


def fixes(latitude=47.0, longitude=8.0, sigma=None, count=9):
    """Good fixes about 47, 8 degrees, one a second, with one other in row 4."""
    made = Fixes(np.arange(float(count)), np.full(count, 47.0), np.full(count, 8.0), np.full(count, 2.0))
    made.latitude_deg[ROW], made.longitude_deg[ROW] = latitude, longitude
    if sigma is not None:
        made.sigma[ROW] = sigma
    return made


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
def test_what_is_no_place_on_earth_is_left_out_and_named(latitude, longitude):
    found = localise_fixes(fixes(latitude, longitude), 0.0, 8.0, 5.0, True)
    assert found.input_row.tolist() == [0, 1, 2, 4, 5, 6, 7, 8]
    (text,) = found.warnings
    assert "1 of 9 fixes" in text
    assert "row 4 (t = 3.000 s)" in text
    assert "not on Earth" in text


@pytest.mark.parametrize(("latitude", "longitude"), [(90.0, 8.0), (-90.0, 8.0), (47.0, 188.0), (-47.0, 8.0)])
def test_a_place_on_earth_far_from_the_others_is_left_out_for_that(latitude, longitude):
    found = localise_fixes(fixes(latitude, longitude), 0.0, 8.0, 5.0, True)
    assert ROW not in found.input_row
    assert "from the others" in found.warnings[0]


@pytest.mark.parametrize("longitude", [8.0, 368.0 - 360.0, -352.0])
def test_a_longitude_counts_modulo_a_turn(longitude):
    found = localise_fixes(fixes(47.0, longitude), 0.0, 8.0, 5.0, True)
    assert found.warnings == ()
    assert np.max(np.abs(found.position)) < 1e-3


@pytest.mark.parametrize("place", [(90.0, 0.0), (47.0, 360.0), (47.0, -360.0)])
def test_the_ends_of_the_scales_are_places(place):
    latitude, longitude = np.full(4, place[0]), np.full(4, place[1])
    found = localise_fixes(Fixes(np.arange(4.0), latitude, longitude), 0.0, 3.0, 5.0, True)
    assert len(found.t) == 4


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
def test_a_sigma_that_says_nothing_is_the_configured_one(sigma, declared, used):
    found = localise_fixes(fixes(sigma=sigma), 0.0, 8.0, 5.0, declared)
    assert found.sigma[ROW] == used
    own = Fixes(np.zeros(1), np.array([47.0]), np.array([8.0]), np.array([sigma]))
    live = localise_fix(own, make_local_frame(47.0, 8.0), GraphConfig(use_declared_sigmas=declared), 1.0)
    assert live.sigma[0] == used


def test_fixes_outside_the_odometry_are_left_out_and_said_beyond_two_seconds():
    found = localise_fixes(fixes(), 1.5, 6.5, 5.0, True)
    assert found.input_row.tolist() == [2, 3, 4, 5, 6]
    assert found.warnings == ()
    later = localise_fixes(fixes(), 3.5, 20.0, 5.0, True)
    assert "2 of 9 fixes" in later.warnings[0]
    assert "outside the odometry" in later.warnings[0]
    with pytest.raises(InputError, match="outside the odometry"):
        localise_fixes(fixes(), 100.0, 200.0, 5.0, True)
    with pytest.raises(InputError, match="no fix in it"):
        localise_fixes(fixes(count=9).__class__(*np.zeros((3, 0))), 0.0, 1.0, 5.0, True)


@dataclass(frozen=True, eq=False)
class Gates:
    """A gate of known latitude that the vehicle passes: north of the frame is known, east is not."""

    t: Array
    north: Array

    @property
    def pose_times(self):
        return self.t

    def build_factors(self, cut, config):
        inside = (self.t >= cut.pose_t[0]) & (self.t <= cut.pose_t[-1])
        state = np.searchsorted(cut.pose_t, self.t[inside])
        return GateFactors(state, self.north[inside], np.full(len(state), 0.02)) if len(state) else None


@dataclass(frozen=True, eq=False)
class GateFactors(FactorGroup):
    """north = y + noise."""

    north: Array
    sigma: Array

    def linearise(self, poses, constants):
        residual = ((poses[self.pose_index, 1] - self.north) / self.sigma)[:, None]
        by_state = np.zeros((len(residual), 1, 3))
        by_state[:, 0, 1] = 1.0 / self.sigma
        return LinearisedFactors(
            self.pose_index, residual, by_state, None, np.zeros((len(residual), 1, N_CONSTANTS))
        )

    def describe_outliers(self, out, norm, state_t):
        return [f"gate: passed {len(norm)} times"]


def test_a_kind_of_factor_that_nobody_knew_is_solved_reviewed_and_judged_by_gtsam():
    path = wiggly_path(np.random.default_rng(51))
    gates = Gates(np.array([4.05, 11.0]), np.array([1.0, 2.5]))
    # Gates that contradict each other have one optimum where the odometry is firm.
    drive = build_graph(path, [gates], GraphConfig(noise=StepNoise(along=0.005, sideways=0.005)))
    ours = solve_graph(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    poses, _, cost = solve_with_gtsam(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS))
    assert cost == pytest.approx(ours.cost, rel=1e-8)
    assert np.max(np.abs(poses - ours.poses)) < 1e-4
    assert any("passed 2 times" in text for text in fuse_graph(path, None, None, None, [gates]).warnings)


def test_a_kind_of_factor_that_nobody_knew_counts_live():
    rng = np.random.default_rng([52, 46])
    drive = gnss_drives.drive(rng, gnss_drives.loop(rng, length=60.0), fix_hz=2.0)
    ends = []
    for known in (False, True):
        live, place = LiveGraph(), 0
        for i, t in enumerate(drive.odo_t):
            live.add_odometry(t, drive.odo_x[i], drive.odo_y[i], drive.odo_heading[i])
            while drive.fix_t[place] < t and place < len(drive.fix_t) - 1:
                live.add_fix(
                    drive.fix_t[place], drive.fix_latitude_deg[place], drive.fix_longitude_deg[place]
                )
                place += 1
            state = live.state()
            if known and state is not None and i % 50 == 0:
                _, oy = state.frame.to_local(*gnss_drives.geodetic(0.0, 0.0, *drive.origin))
                north = list(drive.truth(t + 0.05))[1] + oy
                live.add_samples(t + 0.05, Gates(np.array([t + 0.05]), np.array([float(north)])))
        state = live.state()
        _, oy = state.frame.to_local(*gnss_drives.geodetic(0.0, 0.0, *drive.origin))
        ends.append((abs(state.y - oy - list(drive.truth(state.t))[1]), np.sqrt(state.covariance[1, 1])))
    assert ends[1][1] < 0.5 * ends[0][1]
    assert ends[1][0] < 4.0 * ends[1][1]


def test_the_odometry_of_a_path_is_checked():
    t = np.arange(3.0)
    with pytest.raises(InputError, match="increasing time"):
        fuse_graph(Track(t[::-1], t, t, t), None)
    with pytest.raises(InputError, match="not finite"):
        fuse_graph(Track(t, t, t * np.nan, t), None)
