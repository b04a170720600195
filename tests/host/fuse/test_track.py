"""A track from odometry states, rotated to its start heading, and its error against the truth."""

import numpy as np
import pytest

from hubodo.fuse.differential_odometry import OdometryState
from hubodo.fuse.track import Track, score_track, track_from_states

T = np.arange(0.0, 10.5, 0.5)
ZEROS = np.zeros(len(T))


def state(t_ns, x, y, heading, covariance):
    rows = tuple(tuple(row) for row in covariance.tolist())
    return OdometryState(t_ns, x, y, heading, 0.7, 0.1, 3.0, rows, ((0.0, 0.0), (0.0, 0.0)))


@pytest.mark.parametrize("heading", [0.0, 0.8, -2.0])
def test_a_track_is_rotated_to_its_start_heading_with_its_sigmas(heading):
    rng = np.random.default_rng(3)
    states, expected = [], []
    for k in range(4):
        root = rng.standard_normal((3, 3))
        covariance = root @ root.T
        x, y, state_heading = rng.standard_normal(3)
        states.append(state(1_500_000_000 * k, x, y, state_heading, covariance))
        # Standard deviation along each axis after the rotation.
        ahead = np.array([np.cos(heading), -np.sin(heading), 0.0])
        aside = np.array([np.sin(heading), np.cos(heading), 0.0])
        sigmas = [np.sqrt(axis @ covariance @ axis) for axis in (ahead, aside, np.array([0.0, 0.0, 1.0]))]
        position = complex(x, y) * np.exp(1j * heading)
        expected.append([1.5 * k, position.real, position.imag, state_heading + heading, 0.7, *sigmas])
    track = track_from_states(states, heading)
    result = [track.t, track.x, track.y, track.heading, track.speed]
    result += [track.sigma_x, track.sigma_y, track.sigma_heading]
    np.testing.assert_allclose(np.transpose(result), expected, atol=1e-12)


def test_without_states_there_is_no_track():
    with pytest.raises(ValueError, match="no time in common"):
        track_from_states([])


def straight(t=T):
    """Return a track at 2 m/s along x, from x = 3."""
    return Track(t, 3.0 + 2.0 * t, 0.0 * t, 0.0 * t, 0.0 * t + 2.0, *np.zeros((3, len(t))))


def test_truth_is_shifted_to_the_start_of_the_track():
    """The truth drifts by 0.1 m/s to the left, and jumps back by half of it at the end."""
    drift = np.where(T < 9.9, 0.1 * T, 0.5)
    result = score_track(straight(), T, 2.0 * T - 40.0, 7.0 - drift, None)
    path = float(np.sum(np.hypot(np.diff(2.0 * T), np.diff(drift))))
    assert result.final_error == pytest.approx(0.5) and result.maximum_error == pytest.approx(0.95)
    assert result.rms_error == pytest.approx(np.sqrt(np.mean(drift**2)))
    for percent, error in (
        (result.final_percent, result.final_error),
        (result.rms_percent, result.rms_error),
        (result.maximum_percent, result.maximum_error),
    ):
        assert percent == pytest.approx(100.0 * error / path)
    assert result.heading_rms is None
    assert straight().distance == pytest.approx(20.0)


@pytest.mark.parametrize("degrees", [-170.0, -17.9, 40.0])
def test_a_track_rotated_about_its_start_fits_the_truth_after_that_rotation(degrees):
    """The truth bends and has a bump of 0.3 m, so that a wrong sign or centre would leave errors."""
    x, y = 2.0 * T, 0.1 * T**2
    turned = (x + 1j * (y + 0.3 * np.exp(-((T - 5.0) ** 2)))) * np.exp(1j * np.radians(degrees))
    track = Track(T, 3.0 + x, y - 4.0, 0.0 * T, 0.0 * T, *np.zeros((3, len(T))))
    result = score_track(track, T, turned.real, turned.imag, None)
    assert np.degrees(result.rotation) == pytest.approx(degrees, abs=0.5)
    assert 0.2 < result.rotated_maximum_error < 0.3 < result.maximum_error
    path = np.abs(np.diff(turned)).sum()
    assert result.rotated_maximum_percent == pytest.approx(100.0 * result.rotated_maximum_error / path)


def test_only_the_common_time_of_track_and_truth_is_scored():
    error = 0.3 * np.clip(T - 4.0, 0.0, 2.0)
    selected = (T >= 4.0) & (T <= 8.0)
    result = score_track(straight(), T[selected], 2.0 * T[selected], error[selected], None)
    assert result.final_error == pytest.approx(0.6)
    assert result.rms_error == pytest.approx(np.sqrt(np.mean(error[selected] ** 2)))
    shorter_track = straight(T[selected])
    assert score_track(shorter_track, T, 2.0 * T, ZEROS, None).final_error == pytest.approx(0.0)
    assert score_track(shorter_track, T + 8.0, 2.0 * T, ZEROS, None) is None
    assert score_track(shorter_track, T + 7.5, 2.0 * T, ZEROS, None) is not None


def test_headings_are_compared_to_the_nearest_turn():
    """The heading of the truth is wrapped, that of the track is not."""
    heading = 1.5 * T
    track = Track(T, T, T, heading, ZEROS, *np.zeros((3, len(T))))
    for error, rms in ((0.2, 0.2), (-0.2, 0.2), (2.0 * np.pi + 0.1, 0.1), (3.0, 3.0)):
        reported = np.angle(np.exp(1j * (heading - error)))
        # Also between samples of the truth.
        result = score_track(track, T, T, T, reported)
        assert result.heading_rms == pytest.approx(rms)
        assert score_track(track, T[::2], T[::2], T[::2], reported[::2]).heading_rms == pytest.approx(rms)


def test_a_stationary_truth_has_no_percentages():
    result = score_track(straight(), T, ZEROS, ZEROS, None)
    assert result.final_error == pytest.approx(20.0)
    assert (result.final_percent, result.rms_percent, result.maximum_percent) == (None, None, None)
    assert result.rotation is None and result.rotated_maximum_error is None
