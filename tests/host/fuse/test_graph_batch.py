"""Batch fusion of whole drives from a generator that shares no code with the graph."""

import numpy as np
import pytest
from scipy.stats import chi2

from generators import gnss_drives
from generators.gnss_drives import Errors
from graph_drives import drive_fixes, odometry_path, position_rms, simulate_drive, track_errors
from hubodo.fuse.graph.batch import GraphConfig, Headings, fuse_graph
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.constants import ConstantSigmas
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.odometry_steps import StepNoise
from hubodo.fuse.track import find_gnss_outages
from repetitions import first_and_more

PAPER = GraphConfig(
    use_declared_sigmas=False,
    noise=StepNoise(relative_error=0.1),
    constants=ConstantSigmas(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    inflate_sigmas=False,
    estimate_delay=False,
)
"""Settings of Shah et al., section IV.

Odometry noise 10 % of the increment, fixes of 5 m in east and north, no constants estimated.
"""


@pytest.mark.parametrize("seed", first_and_more(0, 1, 2, 3))
def test_with_five_metre_fixes_a_loop_is_accurate_to_a_metre_for_any_start_heading(seed):
    drive = simulate_drive(seed)
    result = fuse_graph(odometry_path(drive), drive_fixes(drive))
    assert position_rms(track_errors(drive, result)) < 1.0
    assert result.warnings == ()


@pytest.mark.parametrize("heading", np.linspace(-np.pi, np.pi, 9))
def test_no_start_heading_leads_to_a_wrong_minimum(heading):
    drive = simulate_drive(20, length=80.0, start_heading=heading)
    result = fuse_graph(odometry_path(drive), drive_fixes(drive))
    error = track_errors(drive, result)
    assert abs(error[0, 2]) < 0.2
    assert position_rms(error) < 1.5


def draw_from_priors(rng):
    """Return errors drawn from the priors, and the constants that correct them."""
    sigma, noise = ConstantSigmas(), StepNoise()
    sigmas = np.array([sigma.wheel_radius, sigma.yaw_scale, sigma.yaw_rate, sigma.curvature])
    scale, yaw_scale, yaw_rate, curvature = sigmas * rng.standard_normal(4)
    errors = Errors(scale, yaw_scale, yaw_rate, curvature, noise.along, noise.sideways, noise.heading)
    corrections = [
        1 / (1 + scale) - 1,
        1 / (1 + yaw_scale) - 1,
        -yaw_rate / (1 + yaw_scale),
        -curvature / (1 + yaw_scale) / (1 + scale),
    ]
    return errors, np.array(corrections)


@pytest.mark.parametrize("seeds", first_and_more(range(10), range(10, 40)), ids=str)
def test_nees_of_poses_and_constants_is_inside_the_chi_square_band(seeds):
    """The mean NEES of one pose (3 dof) and of four constants of each drive lie in the 99.9 % band."""
    pose_nees, constants_nees, drives = [], [], len(seeds)
    for seed in seeds:
        errors, corrections = draw_from_priors(np.random.default_rng([seed, 45]))
        drive = simulate_drive(seed, length=100.0, errors=errors, rate_hz=10.0, fix_hz=2.0)
        result = fuse_graph(odometry_path(drive), drive_fixes(drive))
        error = track_errors(drive, result)
        k = len(result.solution.poses) // 3 + seed
        index = np.interp(result.pose_t[k], result.track.t, np.arange(len(error)))
        deviation = np.array([np.interp(index, np.arange(len(error)), column) for column in error.T])
        pose_nees.append(deviation @ np.linalg.solve(result.solution.covariance[k], deviation))
        deviation = result.solution.constants[:4] - corrections
        constants_nees.append(
            deviation @ np.linalg.solve(result.solution.constants_covariance[:4, :4], deviation)
        )
    for nees, dimensions in ((pose_nees, 3), (constants_nees, 4)):
        low, high = chi2.ppf([0.0005, 0.9995], dimensions * drives) / drives
        assert low < np.mean(nees) < high, f"{np.mean(nees):.2f} of {dimensions}"


def test_precise_fixes_calibrate_the_wheels():
    errors = Errors(0.008, -0.012, 4e-4, 1e-3, 0.002, 0.002, 2e-4)
    drive = simulate_drive(
        3, errors=errors, sigma=0.02, motion=lambda rng: gnss_drives.loop(rng, laps=4, speed=(0.4, 2.5))
    )
    result = fuse_graph(odometry_path(drive), drive_fixes(drive, sigma=0.02)).constants
    expected = {
        "wheel_radius": 1 / 1.008 - 1,
        "yaw_scale": 1 / 0.988 - 1,
        "yaw_rate": -4e-4 / 0.988,
        "curvature": -1e-3 / 0.988 / 1.008,
    }
    for name, value in expected.items():
        assert abs(result[name].value - value) < 4.0 * result[name].sigma, name
    assert result["wheel_radius"].sigma < 3e-4
    assert result["yaw_scale"].sigma < 1e-3


def test_the_track_is_better_than_the_fixes_alone():
    for seed in range(5):
        drive = simulate_drive(seed, sigma=20.0, length=120.0)
        result = fuse_graph(odometry_path(drive), drive_fixes(drive, sigma=20.0))
        x, y = result.frame.to_local(drive.fix_latitude_deg, drive.fix_longitude_deg)
        zero = np.zeros(1)
        ox, oy = result.frame.to_local(*gnss_drives.geodetic(zero, zero, *drive.origin))
        tx, ty, _ = drive.truth(drive.fix_t)
        fixes_rms = np.sqrt(np.mean((x - ox - tx) ** 2 + (y - oy - ty) ** 2))
        assert position_rms(track_errors(drive, result)) < fixes_rms


def test_the_antenna_offset_is_accounted_for():
    """Fixes of 2 cm show a missing lever arm clearly."""
    drive = simulate_drive(5, sigma=0.02, antenna=(0.6, -0.3))
    fixes = drive_fixes(drive, sigma=0.02)
    with_antenna = fuse_graph(odometry_path(drive), fixes, None, GraphConfig(antenna=(0.6, -0.3)))
    without_antenna = fuse_graph(odometry_path(drive), fixes)
    assert position_rms(track_errors(drive, with_antenna)) < 0.02
    # A forward lever arm is similar to a delay; a lateral one is not similar to any other state.
    assert position_rms(track_errors(drive, without_antenna)) > 0.2


def test_the_error_after_an_outage_of_a_minute_is_below_a_percent_of_its_distance():
    drive = simulate_drive(6)
    received = (drive.fix_t < 80.0) | (drive.fix_t > 140.0)
    result = fuse_graph(odometry_path(drive), drive_fixes(drive, received))
    zero = np.zeros(1)
    ox, oy = result.frame.to_local(*gnss_drives.geodetic(zero, zero, *drive.origin))
    truth = (drive.t, drive.x + ox[0] + 7.0, drive.y + oy[0] - 3.0)
    (outage,) = find_gnss_outages(result.track, result.fix_t, truth)
    assert outage.end - outage.start == pytest.approx(60.2, abs=0.3)
    assert outage.percent is not None
    assert outage.percent < 1.0
    rolled = np.cumsum(drive.speed) * 1e-3
    distance = np.interp(outage.end, drive.t, rolled) - np.interp(outage.start, drive.t, rolled)
    assert outage.distance == pytest.approx(distance, rel=0.02)
    (without_truth,) = find_gnss_outages(result.track, result.fix_t)
    assert without_truth.error is None
    assert without_truth.percent is None


def test_one_fix_determines_the_position_but_not_the_heading():
    drive = simulate_drive(12)
    result = fuse_graph(odometry_path(drive), drive_fixes(drive, slice(300, 301)))
    assert any("one fix only" in text for text in result.warnings)
    assert any("heading: known to" in text for text in result.warnings)
    k = int(np.searchsorted(result.track.t, drive.fix_t[300]))
    assert np.hypot(result.track.sigma_x[k], result.track.sigma_y[k]) < 8.0
    assert result.track.sigma_heading.min() > 1.0
    assert result.track.sigma_x[-1] > 10.0


def test_a_stationary_vehicle_has_a_position_but_no_heading():
    drive = simulate_drive(13, motion=lambda rng: (np.zeros(30_000), np.zeros(30_000)))
    result = fuse_graph(odometry_path(drive), drive_fixes(drive))
    assert position_rms(track_errors(drive, result)) < 4.0 * 5.0 / np.sqrt(len(drive.fix_t)) * np.sqrt(2.0)
    assert any("heading: known to" in text for text in result.warnings)


def test_a_compass_determines_the_heading_where_fixes_cannot():
    drive = simulate_drive(17)
    t = np.arange(0.5, drive.t[-1], 0.1)
    _, _, heading = drive.truth(t)
    rng = np.random.default_rng(17)
    observed = np.mod(heading + 0.05 * rng.standard_normal(len(t)) + np.pi, 2.0 * np.pi) - np.pi
    headings = Headings(t, observed, np.full(len(t), 0.05))
    result = fuse_graph(odometry_path(drive), drive_fixes(drive, slice(300, 301)), headings)
    error = track_errors(drive, result)
    assert np.max(np.abs(error[:, 2])) < 0.15
    without = fuse_graph(odometry_path(drive), None, headings)
    assert without.frame is None
    assert without.track.x[0] == pytest.approx(0.0, abs=1e-6)


def test_a_heading_that_drifts_by_turns_does_not_mislead_the_initial_guess():
    drive = simulate_drive(
        18,
        errors=Errors(0.01, 0.02, 4e-3, 2e-2, 0.003, 0.003, 3e-4),
        motion=lambda rng: gnss_drives.loop(rng, laps=3),
    )
    drift = drive.odo_heading[-1] - (drive.heading[-1] - drive.heading[0])
    assert abs(drift) > 2.0 * np.pi
    result = fuse_graph(odometry_path(drive), drive_fixes(drive))
    assert position_rms(track_errors(drive, result)) < 1.0


def test_the_settings_of_the_paper_give_ten_percent_and_five_metres():
    drive = simulate_drive(19)
    result = fuse_graph(odometry_path(drive), drive_fixes(drive, sigma=1.0), None, PAPER)
    assert position_rms(track_errors(drive, result)) < 1.0
    assert np.all(result.graph.find_group(PositionFactors).sigma == 5.0)
    steps = result.graph.find_group(BetweenFactors).steps
    displacement = np.abs(np.add.reduceat(steps.correct_displacements(np.zeros(6)), steps.first_step))
    assert np.allclose(steps.covariance[:, 0, 0], (0.1 * displacement) ** 2 + 1e-6)
    assert all(abs(value.value) < 1e-6 for value in result.constants.values())


def test_the_error_does_not_depend_on_the_rate_of_the_odometry():
    results = []
    for rate in (10.0, 100.0):
        drive = simulate_drive(21, length=120.0, errors=Errors(0.002, 0.005), rate_hz=rate)
        results.append((drive, fuse_graph(odometry_path(drive), drive_fixes(drive))))
    first, second = (track_errors(drive, result) for drive, result in results)
    assert position_rms(first) == pytest.approx(position_rms(second), abs=0.01)


def test_the_track_relative_to_its_start_begins_at_zero_with_zero_sigma():
    drive = simulate_drive(22)
    track = fuse_graph(odometry_path(drive), drive_fixes(drive)).from_start
    assert track.x[0] == track.y[0] == 0.0
    assert track.sigma_x[0] < 1e-3
    assert track.sigma_x.max() > 0.05


def test_a_fix_between_odometry_poses_is_interpolated_on_the_arc():
    """Poses between graph poses, which are at the fixes, equal the noiseless true trajectory to 3 mm."""
    drive = simulate_drive(23, length=60.0, errors=Errors(), sigma=1e-4, rate_hz=20.0)
    result = fuse_graph(odometry_path(drive), drive_fixes(drive, sigma=0.005))
    error = track_errors(drive, result)
    assert np.max(np.abs(error[:, :2])) < 0.003
