"""The factor graph of whole drives, on data of a generator that shares nothing with it."""

import numpy as np
import pytest
from scipy.stats import chi2

from generators import gnss_drives
from generators.gnss_drives import Errors
from graph_drives import errors_of, fixes_of, make, path_of, rms
from hubodo.fuse.graph.batch import GraphConfig, Headings, fuse_graph
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.constants import ConstantSigmas
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.odometry_steps import StepNoise
from hubodo.fuse.track import find_gnss_outages

PAPER = GraphConfig(
    use_declared_sigmas=False,
    noise=StepNoise(relative_error=0.1),
    constants=ConstantSigmas(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    inflate_sigmas=False,
    estimate_delay=False,
)
"""Shah et al. section IV.

Odometry noise 10 % of the increment, fixes 5 m in east and north, no constants solved for.
"""


@pytest.mark.parametrize("seed", range(4))
def test_with_five_metre_fixes_a_loop_is_accurate_to_a_metre_for_any_start_heading(seed):
    drive = make(seed)
    result = fuse_graph(path_of(drive), fixes_of(drive))
    assert rms(errors_of(drive, result)) < 1.0
    assert result.warnings == ()


@pytest.mark.parametrize("heading", np.linspace(-np.pi, np.pi, 9))
def test_no_start_heading_leads_to_a_wrong_minimum(heading):
    drive = make(20, length=80.0, start_heading=heading)
    result = fuse_graph(path_of(drive), fixes_of(drive))
    error = errors_of(drive, result)
    assert abs(error[0, 2]) < 0.2
    assert rms(error) < 1.5


def of_the_prior(rng):
    """Return errors drawn from the priors, and the constants that correct them."""
    sigma, noise = ConstantSigmas(), StepNoise()
    size = np.array([sigma.wheel_radius, sigma.yaw_scale, sigma.yaw_rate, sigma.curvature])
    scale, turn, rate, curve = size * rng.standard_normal(4)
    errors = Errors(scale, turn, rate, curve, noise.along, noise.sideways, noise.heading)
    undone = [1 / (1 + scale) - 1, 1 / (1 + turn) - 1, -rate / (1 + turn), -curve / (1 + turn) / (1 + scale)]
    return errors, np.array(undone)


def test_errors_of_poses_and_constants_agree_with_their_covariance():
    """NEES of three dimensions at one pose of each of 30 drives, and of four constants.

    Seeds 0 to 29; both means within the 99.9 % band.
    """
    poses, constants, drives = [], [], 30
    for seed in range(drives):
        errors, undone = of_the_prior(np.random.default_rng([seed, 45]))
        drive = make(seed, length=100.0, errors=errors, rate_hz=10.0, fix_hz=2.0)
        result = fuse_graph(path_of(drive), fixes_of(drive))
        error = errors_of(drive, result)
        k = len(result.solution.poses) // 3 + seed
        at = np.interp(result.pose_t[k], result.track.t, np.arange(len(error)))
        e = np.array([np.interp(at, np.arange(len(error)), column) for column in error.T])
        poses.append(e @ np.linalg.solve(result.solution.covariance[k], e))
        e = result.solution.constants[:4] - undone
        constants.append(e @ np.linalg.solve(result.solution.constants_covariance[:4, :4], e))
    for nees, dimensions in ((poses, 3), (constants, 4)):
        low, high = chi2.ppf([0.0005, 0.9995], dimensions * drives) / drives
        assert low < np.mean(nees) < high, f"{np.mean(nees):.2f} of {dimensions}"


def test_precise_fixes_calibrate_the_wheels():
    errors = Errors(0.008, -0.012, 4e-4, 1e-3, 0.002, 0.002, 2e-4)
    drive = make(
        3, errors=errors, sigma=0.02, motion=lambda rng: gnss_drives.loop(rng, laps=4, speed=(0.4, 2.5))
    )
    result = fuse_graph(path_of(drive), fixes_of(drive, sigma=0.02)).constants
    true = {
        "wheel_radius": 1 / 1.008 - 1,
        "yaw_scale": 1 / 0.988 - 1,
        "yaw_rate": -4e-4 / 0.988,
        "curvature": -1e-3 / 0.988 / 1.008,
    }
    for name, value in true.items():
        assert abs(result[name].value - value) < 4.0 * result[name].sigma, name
    assert result["wheel_radius"].sigma < 3e-4
    assert result["yaw_scale"].sigma < 1e-3


def test_the_track_is_better_than_the_fixes_alone():
    for seed in range(5):
        drive = make(seed, sigma=20.0, length=120.0)
        result = fuse_graph(path_of(drive), fixes_of(drive, sigma=20.0))
        x, y = result.frame.to_local(drive.fix_latitude_deg, drive.fix_longitude_deg)
        zero = np.zeros(1)
        ox, oy = result.frame.to_local(*gnss_drives.geodetic(zero, zero, *drive.origin))
        tx, ty, _ = drive.truth(drive.fix_t)
        single = np.sqrt(np.mean((x - ox - tx) ** 2 + (y - oy - ty) ** 2))
        assert rms(errors_of(drive, result)) < single


def test_the_antenna_offset_is_accounted_for():
    """A lever arm left out shows at once with fixes of 2 cm."""
    drive = make(5, sigma=0.02, antenna=(0.6, -0.3))
    fixes = fixes_of(drive, sigma=0.02)
    known = fuse_graph(path_of(drive), fixes, None, GraphConfig(antenna=(0.6, -0.3)))
    unknown = fuse_graph(path_of(drive), fixes)
    assert rms(errors_of(drive, known)) < 0.02
    # A forward lever arm looks like a delay, a lateral one like nothing else.
    assert rms(errors_of(drive, unknown)) > 0.2


def test_the_error_after_an_outage_of_a_minute_is_below_a_percent_of_its_distance():
    drive = make(6)
    keep = (drive.fix_t < 80.0) | (drive.fix_t > 140.0)
    result = fuse_graph(path_of(drive), fixes_of(drive, keep))
    zero = np.zeros(1)
    ox, oy = result.frame.to_local(*gnss_drives.geodetic(zero, zero, *drive.origin))
    truth = (drive.t, drive.x + ox[0] + 7.0, drive.y + oy[0] - 3.0)
    (gap,) = find_gnss_outages(result.track, result.fix_t, truth)
    assert gap.end - gap.start == pytest.approx(60.2, abs=0.3)
    assert gap.percent is not None
    assert gap.percent < 1.0
    rolled = np.cumsum(drive.speed) * 1e-3
    distance = np.interp(gap.end, drive.t, rolled) - np.interp(gap.start, drive.t, rolled)
    assert gap.distance == pytest.approx(distance, rel=0.02)
    (without_truth,) = find_gnss_outages(result.track, result.fix_t)
    assert without_truth.error is None
    assert without_truth.percent is None


def test_one_fix_determines_the_position_but_not_the_direction():
    drive = make(12)
    result = fuse_graph(path_of(drive), fixes_of(drive, slice(300, 301)))
    assert any("one fix only" in text for text in result.warnings)
    assert any("heading: known to" in text for text in result.warnings)
    k = int(np.searchsorted(result.track.t, drive.fix_t[300]))
    assert np.hypot(result.track.sigma_x[k], result.track.sigma_y[k]) < 8.0
    assert result.track.sigma_heading.min() > 1.0
    assert result.track.sigma_x[-1] > 10.0


def test_a_stationary_vehicle_has_a_position_but_no_heading():
    drive = make(13, motion=lambda rng: (np.zeros(30_000), np.zeros(30_000)))
    result = fuse_graph(path_of(drive), fixes_of(drive))
    assert rms(errors_of(drive, result)) < 4.0 * 5.0 / np.sqrt(len(drive.fix_t)) * np.sqrt(2.0)
    assert any("heading: known to" in text for text in result.warnings)


def test_a_compass_determines_the_heading_where_fixes_cannot():
    drive = make(17)
    t = np.arange(0.5, drive.t[-1], 0.1)
    _, _, heading = drive.truth(t)
    rng = np.random.default_rng(17)
    observed = np.mod(heading + 0.05 * rng.standard_normal(len(t)) + np.pi, 2.0 * np.pi) - np.pi
    headings = Headings(t, observed, np.full(len(t), 0.05))
    result = fuse_graph(path_of(drive), fixes_of(drive, slice(300, 301)), headings)
    error = errors_of(drive, result)
    assert np.max(np.abs(error[:, 2])) < 0.15
    without = fuse_graph(path_of(drive), None, headings)
    assert without.frame is None
    assert without.track.x[0] == pytest.approx(0.0, abs=1e-6)


def test_a_heading_that_drifts_by_turns_does_not_mislead_the_initial_guess():
    drive = make(
        18,
        errors=Errors(0.01, 0.02, 4e-3, 2e-2, 0.003, 0.003, 3e-4),
        motion=lambda rng: gnss_drives.loop(rng, laps=3),
    )
    drift = drive.odo_heading[-1] - (drive.heading[-1] - drive.heading[0])
    assert abs(drift) > 2.0 * np.pi
    result = fuse_graph(path_of(drive), fixes_of(drive))
    assert rms(errors_of(drive, result)) < 1.0


def test_the_settings_of_the_paper_are_ten_percent_and_five_metres():
    drive = make(19)
    result = fuse_graph(path_of(drive), fixes_of(drive, sigma=1.0), None, PAPER)
    assert rms(errors_of(drive, result)) < 1.0
    assert np.all(result.graph.find_group(PositionFactors).sigma == 5.0)
    steps = result.graph.find_group(BetweenFactors).steps
    shifted = np.abs(np.add.reduceat(steps.correct_displacements(np.zeros(6)), steps.first_step))
    assert np.allclose(steps.covariance[:, 0, 0], (0.1 * shifted) ** 2 + 1e-6)
    assert all(abs(value.value) < 1e-6 for value in result.constants.values())


def test_the_rate_of_the_odometry_does_not_matter():
    results = []
    for rate in (10.0, 100.0):
        drive = make(21, length=120.0, errors=Errors(0.002, 0.005), rate_hz=rate)
        results.append((drive, fuse_graph(path_of(drive), fixes_of(drive))))
    first, second = (errors_of(drive, result) for drive, result in results)
    assert rms(first) == pytest.approx(rms(second), abs=0.01)


def test_from_start_begins_at_zero_with_zero_sigma():
    drive = make(22)
    track = fuse_graph(path_of(drive), fixes_of(drive)).from_start
    assert track.x[0] == track.y[0] == 0.0
    assert track.sigma_x[0] < 1e-3
    assert track.sigma_x.max() > 0.05


def test_a_fix_between_odometry_poses_is_interpolated_on_the_arc():
    """Poses between graph poses, which are at the fixes, equal the noiseless truth to millimetres."""
    drive = make(23, length=60.0, errors=Errors(), sigma=1e-4, rate_hz=20.0)
    result = fuse_graph(path_of(drive), fixes_of(drive, sigma=0.005))
    error = errors_of(drive, result)
    assert np.max(np.abs(error[:, :2])) < 0.003
