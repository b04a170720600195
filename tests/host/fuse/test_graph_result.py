"""Result of the graph at the times of the odometry, and the initial guess aligned with the fixes."""

from types import SimpleNamespace

import numpy as np
import pytest

from generators import gnss_drives
from graph_drives import wiggly_path
from hubodo.errors import InputError
from hubodo.fuse.graph.batch import fuse_graph
from hubodo.fuse.graph.build import _choose_pose_times, _start_prior, build_graph
from hubodo.fuse.graph.config import GraphConfig
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.constants import CONSTANT_NAMES, N_CONSTANTS
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.fixes import Fixes, localise_fixes
from hubodo.fuse.graph.odometry_steps import StepNoise, segment_odometry
from hubodo.fuse.graph.result import DriveGraph, build_result
from hubodo.fuse.track import Track


@pytest.mark.parametrize("speed", [1.2, -0.4])
def test_a_reversing_vehicle_has_a_negative_speed_at_any_heading(speed):
    """The path is a circle to the left at 10 Hz, from a heading of 2 rad."""
    t = np.arange(0.0, 8.0, 0.1)
    heading = 2.0 + 0.5 * t
    x, y = (speed / 0.5 * part for part in (np.sin(heading) - np.sin(2.0), np.cos(2.0) - np.cos(heading)))
    track = fuse_graph(Track(t, x, y, heading), None).track
    # A chord of 0.05 rad is 1e-4 shorter than its arc.
    assert track.speed == pytest.approx(np.full(len(t), speed), rel=2e-4)


@pytest.mark.parametrize("turn", [0.0, 1.3, -2.8])
def test_the_initial_guess_is_aligned_with_the_fixes_for_any_offset_and_rotation(turn):
    path = wiggly_path(np.random.default_rng(3))
    rotated = (path.x + 1j * path.y) * np.exp(1j * turn)
    every_fifth = slice(0, None, 5)
    coordinates = gnss_drives.geodetic(rotated.real[every_fifth], rotated.imag[every_fifth], 47.0, 8.0)
    local = localise_fixes(Fixes(path.t[every_fifth], *coordinates), path.t[0], path.t[-1], 0.1, True)
    displaced = Track(path.t, path.x + 300.0, path.y - 200.0, path.heading)
    drive = build_graph(displaced, [local], GraphConfig())
    pose_index = np.searchsorted(drive.odometry.pose_t, local.t)
    assert drive.initial_poses[pose_index, 0] == pytest.approx(local.position.real, abs=0.1)
    assert drive.initial_poses[pose_index, 1] == pytest.approx(local.position.imag, abs=0.1)
    difference = drive.initial_poses[pose_index, 2] - path.heading[every_fifth] - turn
    assert np.abs(np.angle(np.exp(1j * difference))).max() < 0.02


@pytest.mark.parametrize("t", [[0.0, 1.0, 0.5, 2.0], [0.0, 1.0, 1.0, 2.0], [0.0]])
def test_odometry_whose_time_does_not_increase_raises_an_input_error(t):
    with pytest.raises(InputError, match="increasing time"):
        fuse_graph(Track(np.array(t), *np.zeros((3, len(t)))), None)


UNEVEN = np.array([0.0, 0.1, 0.3, 0.6, 1.0])


def test_the_velocity_at_a_pose_is_the_mean_of_its_two_adjacent_steps():
    """Steps have 1, 2, 3 and 4 m/s; at either end the two nearest are used."""
    distance = np.append(0.0, np.cumsum(np.arange(1.0, 5.0) * np.diff(UNEVEN)))
    path = Track(UNEVEN, distance * np.cos(0.5), distance * np.sin(0.5), np.full(5, 0.5))
    full = segment_odometry(path, UNEVEN[[0, 2, 4]], StepNoise()).velocity
    ends = [0.5 / 0.3, 1.3 / 0.5, 2.5 / 0.7]
    np.testing.assert_allclose(full, np.column_stack([ends, np.zeros(3)]), atol=1e-12)
    inside = segment_odometry(path, np.array([0.0, 0.2, 0.6, 1.0]), StepNoise()).velocity
    np.testing.assert_allclose(inside[1], [2.0, 0.0], atol=1e-12)
    single = segment_odometry(path, np.array([0.65, 0.95]), StepNoise()).velocity
    np.testing.assert_allclose(single, [[4.0, 0.0]] * 2, atol=1e-12)


def test_segmented_odometry_interpolates_heading_and_elapsed_fraction():
    """The path is several circles, with headings wrapped to half a turn."""
    t = np.arange(0.0, 20.0, 0.1)
    heading = 1.0 + 0.9 * t
    path = Track(t, np.sin(heading), -np.cos(heading), np.angle(np.exp(1j * heading)))
    segments = segment_odometry(path, np.array([2.0, 5.03, 11.0, 17.5]), StepNoise())
    times = np.linspace(2.0, 17.5, 53)
    np.testing.assert_allclose(segments.heading_at(times), 1.0 + 0.9 * times, atol=1e-9)
    np.testing.assert_allclose(segments.odometry_pose[:, 2], 1.0 + 0.9 * segments.pose_t, atol=1e-9)
    start, end = segments.pose_t[:-1][segments.segment], segments.pose_t[1:][segments.segment]
    np.testing.assert_allclose(segments.elapsed_fraction, (segments.step_end_t - start) / (end - start))
    np.testing.assert_allclose(segments.since_segment_start[:, 1], segments.step_end_t - start, atol=1e-12)
    np.testing.assert_allclose(
        segments.since_segment_start[:, 0], 0.9 * (segments.step_end_t - start), atol=1e-9
    )


def invented_solution(rng):
    """Return a made-up solution of three poses with valid covariances."""
    root = 0.1 * rng.standard_normal((9, 9))
    full = (root @ root.T).reshape(3, 3, 3, 3)
    return SimpleNamespace(
        poses=np.array([[5.0, -2.0, 0.1], [7.2, -1.7, 0.3], [9.0, -1.0, -0.2]]),
        constants=np.array([0.02, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0]),
        covariance=np.array([full[k, :, k] for k in range(3)]),
        start_covariance=np.array([full[k, :, 0] for k in range(3)]),
        constants_covariance=np.diag(np.arange(1.0, 1.0 + N_CONSTANTS) ** 2),
    )


def test_between_poses_the_track_follows_the_odometry_with_the_correction_spread_over_time():
    """Odometry along a straight line at constant speed gives straight lines between poses."""
    t = np.arange(0.0, 4.1, 0.25)
    path = Track(t, 1.1 * t, np.zeros(len(t)), np.zeros(len(t)))
    segments = segment_odometry(path, np.array([0.0, 1.5, 4.0]), StepNoise())
    result = invented_solution(np.random.default_rng(31))
    state, positions = np.array([0, 2]), result.poses[[0, 2], :2] + [[0.0, 0.0], [20.0, 0.0]]
    fixes = PositionFactors(state, positions, np.ones(2), np.zeros((2, 2)))
    drive = DriveGraph(FactorGraph((fixes,)), result.poses, segments, True)
    output = build_result(path, drive, result, None, 1.5, StepNoise(), 0.7, ("a warning",))
    x, y, heading = (np.interp(t, segments.pose_t, column) for column in result.poses.T)
    np.testing.assert_allclose(output.track.x, x, atol=1e-12)
    np.testing.assert_allclose(output.track.y, y, atol=1e-12)
    np.testing.assert_allclose(output.track.heading, heading, atol=1e-12)
    np.testing.assert_allclose(output.from_start.x, x - 5.0, atol=1e-12)
    np.testing.assert_allclose(output.from_start.y, y + 2.0, atol=1e-12)
    # The speed is that of the wheels with their scale, without the corrections of the positions.
    np.testing.assert_allclose(output.track.speed, 1.1 * 1.02)
    # Variances of the position, and of the displacement since the first pose; the heading is absolute in
    # both.
    diagonal, cross = (
        np.einsum("kii->ki", matrices) for matrices in (result.covariance, result.start_covariance)
    )
    since = diagonal + diagonal[0] - 2.0 * cross
    since[:, 2] = diagonal[:, 2]
    for track, variance in ((output.track, diagonal), (output.from_start, since)):
        for sigma, column in zip(
            (track.sigma_x, track.sigma_y, track.sigma_heading), variance.T, strict=True
        ):
            np.testing.assert_allclose(sigma, np.sqrt(np.interp(t, segments.pose_t, np.maximum(column, 0.0))))
    # A fix twenty sigma off has no weight; the delay includes the shift that was removed before.
    np.testing.assert_allclose(output.fix_t, [-0.7, 3.3])
    assert output.fix_weight.tolist() == [1.0, 0.0]
    values = {name: output.constants[name] for name in CONSTANT_NAMES}
    assert values["gnss_delay"].value == pytest.approx(1.0)
    assert values["wheel_radius"].value == pytest.approx(0.02)
    assert [values[name].sigma for name in CONSTANT_NAMES] == pytest.approx(np.arange(1.0, 1.0 + N_CONSTANTS))


def test_with_constants_a_steady_turn_stays_steady_and_passes_through_the_poses():
    t = np.arange(0.0, 4.1, 0.25)
    path = Track(t, 1.1 * t, np.zeros(len(t)), np.zeros(len(t)))
    segments = segment_odometry(path, np.array([0.0, 1.5, 4.0]), StepNoise())
    result = invented_solution(np.random.default_rng(33))
    result.constants = np.array([0.02, -0.03, 0.2, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    output = build_result(
        path,
        DriveGraph(FactorGraph(()), result.poses, segments, True),
        result,
        None,
        1.0,
        StepNoise(),
        0.0,
        (),
    ).track
    x, y, heading = (np.interp(t, segments.pose_t, column) for column in result.poses.T)
    np.testing.assert_allclose(output.heading, heading, atol=1e-12)
    at_poses = np.isin(t, segments.pose_t)
    np.testing.assert_allclose(output.x[at_poses], x[at_poses], atol=1e-12)
    np.testing.assert_allclose(output.y[at_poses], y[at_poses], atol=1e-12)
    # Between poses the path bows out opposite to the side of the turn.
    lateral_offset = (output.y - y) * np.cos(heading) - (output.x - x) * np.sin(heading)
    assert (lateral_offset[~at_poses] < 0.0).all()


def test_without_fixes_a_result_has_no_fix_times():
    path = Track(np.arange(3.0), np.arange(3.0), np.zeros(3), np.zeros(3))
    segments, result = (
        segment_odometry(path, np.arange(3.0), StepNoise()),
        invented_solution(np.random.default_rng(32)),
    )
    output = build_result(
        path,
        DriveGraph(FactorGraph(()), result.poses, segments, True),
        result,
        None,
        1.0,
        StepNoise(),
        0.0,
        (),
    )
    assert len(output.fix_t) == len(output.fix_weight) == 0


@pytest.mark.parametrize("turns", [0, 3, -2])
def test_a_known_start_heading_is_wrapped_to_the_nearest_turn(turns):
    pose, config = np.array([5.0, 6.0, 0.4 + 2.0 * np.pi * turns]), GraphConfig(start_heading=-0.3)
    for on_map, position_sigma in ((True, 1e4), (False, 1e-3)):
        mean, sigma = _start_prior(pose, on_map, config)
        np.testing.assert_allclose(mean, [[5.0, 6.0, -0.3 + 2.0 * np.pi * turns]], atol=1e-12)
        np.testing.assert_allclose(sigma, [[position_sigma, position_sigma, 0.02]])
    mean, sigma = _start_prior(pose, True, GraphConfig())
    # Without a known heading all directions are equally likely.
    np.testing.assert_allclose(mean, pose[None])
    np.testing.assert_allclose(sigma, [[1e4, 1e4, np.pi / np.sqrt(3.0)]])


def test_poses_are_at_samples_and_ends_and_within_the_maximum_spacing():
    path_t = np.arange(0.0, 10.05, 0.1)
    pose_times = _choose_pose_times(path_t, np.array([2.3, 2.9, 7.0]), 1.0)
    assert np.isin([0.0, 2.3, 2.9, 7.0, path_t[-1]], pose_times).all()
    gaps = np.diff(pose_times)
    assert len(pose_times) == 1 + 3 + 1 + 5 + 3 and gaps.max() <= 1.0 + 1e-9
    # Each gap is divided evenly.
    np.testing.assert_allclose(gaps, np.repeat([2.3 / 3, 0.6, 4.1 / 5, 1.0], [3, 1, 5, 3]), atol=1e-9)
    with_outage = np.append(path_t, path_t + 30.0)
    pose_times = _choose_pose_times(with_outage, path_t[:0], 1.0)
    assert np.isin([0.0, path_t[-1], 30.0, with_outage[-1]], pose_times).all() and len(pose_times) == 22
