"""A track of poses with sigmas, its error against a reference track, and its GNSS outages."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.differential_odometry import OdometryState


def _empty() -> Array:
    return np.empty(0)


@dataclass(frozen=True, eq=False)
class Track:
    """Poses of the body origin, N of them, as equally long arrays (N,).

    An array is empty where its source cannot give it: odometry for a graph needs t, x, y and heading alone.

    Attributes
    ----------
    t : s on the log's clock, strictly increasing.
    x, y : m from the start.
    heading : rad, anticlockwise from x.
    speed : m/s, mean over the step that ends at t.
    sigma_x, sigma_y : m, 1 sigma, growing from zero at the start.
    sigma_heading : rad, 1 sigma.
    yaw_rate : rad/s, mean over the step that ends at t.
    cov_xy, cov_x_heading, cov_y_heading : m² and m rad, covariances of x, y and heading.
    step_inflation : (N - 1,) m², variance of each step in any direction beyond that of rolling wheels.
    """

    t: Array
    x: Array
    y: Array
    heading: Array
    speed: Array = field(default_factory=_empty)
    sigma_x: Array = field(default_factory=_empty)
    sigma_y: Array = field(default_factory=_empty)
    sigma_heading: Array = field(default_factory=_empty)
    yaw_rate: Array = field(default_factory=_empty)
    cov_xy: Array = field(default_factory=_empty)
    cov_x_heading: Array = field(default_factory=_empty)
    cov_y_heading: Array = field(default_factory=_empty)
    step_inflation: Array = field(default_factory=_empty)

    @property
    def distance(self) -> float:
        """Return the length of the path, m."""
        return float(np.sum(np.hypot(np.diff(self.x), np.diff(self.y))))


@dataclass(frozen=True, slots=True)
class Score:
    """Position and heading error of a track against the truth.

    Attributes
    ----------
    final_error, rms_error, maximum_error : m.
    final_percent, rms_percent, maximum_percent : % of the true path, None where the truth does not move.
    heading_rms : rad, None where the truth has no heading.
    rotation : rotation of the track about its start that fits the truth best, rad, anticlockwise; a truth may
        have a wrong heading while the vehicle stands. None where the truth does not move.
    rotated_maximum_error, rotated_maximum_percent : largest error after this rotation, m and % of the path.
    """

    final_error: float
    rms_error: float
    maximum_error: float
    final_percent: float | None
    rms_percent: float | None
    maximum_percent: float | None
    heading_rms: float | None
    rotation: float | None = None
    rotated_maximum_error: float | None = None
    rotated_maximum_percent: float | None = None


def track_from_states(states: Sequence[OdometryState], heading: float = 0.0) -> Track:
    """Return the track of differential odometry, rotated so that it starts at `heading`, rad.

    Raises ValueError when there are no states.
    """
    if not states:
        raise ValueError("no poses: the two wheels have no time in common")
    pose = np.array([[s.t_ns * 1e-9, s.x, s.y, s.heading, s.speed, s.yaw_rate] for s in states])
    covariance = np.array([s.covariance for s in states])
    cos, sin = np.cos(heading), np.sin(heading)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    covariance = turn @ covariance @ turn.T
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 0.0))
    x, y = cos * pose[:, 1] - sin * pose[:, 2], sin * pose[:, 1] + cos * pose[:, 2]
    t, _, _, odometry_heading, speed, yaw_rate = pose.T
    sigma_x, sigma_y, sigma_heading = sigma.T
    heading_at_pose = odometry_heading + heading
    return Track(
        *(t, x, y, heading_at_pose, speed, sigma_x, sigma_y, sigma_heading, yaw_rate),
        *cross_covariances(covariance),
    )


def cross_covariances(covariance: Array) -> tuple[Array, Array, Array]:
    """Return the covariances of x with y, x with heading and y with heading, from (N, 3, 3) or larger."""
    return covariance[:, 0, 1], covariance[:, 0, 2], covariance[:, 1, 2]


def score_track(track: Track, t: Array, x: Array, y: Array, heading: Array | None) -> Score | None:
    """Return the error of a track against the truth (t, x, y, heading, each (M,)).

    The truth is shifted to the track's first common position; errors are those without a rotation, except
    where their name says so. Returns None if they have no common time.
    """
    common = (track.t >= t[0]) & (track.t <= t[-1])
    if np.count_nonzero(common) < 2:
        return None
    t_common = track.t[common]
    position = track.x[common] + 1j * track.y[common]
    true_position = np.interp(t_common, t, x) + 1j * np.interp(t_common, t, y)
    position, true_position = position - position[0], true_position - true_position[0]
    error = np.abs(position - true_position)
    path = float(np.sum(np.hypot(np.diff(x), np.diff(y))))
    heading_rms = None
    if heading is not None:
        error_heading = track.heading[common] - np.interp(t_common, t, np.unwrap(heading))
        heading_rms = float(np.sqrt(np.mean((np.mod(error_heading + np.pi, 2 * np.pi) - np.pi) ** 2)))
    errors = (float(error[-1]), float(np.sqrt(np.mean(error**2))), float(error.max()))
    if not path > 0.0:
        return Score(*errors, None, None, None, heading_rms)
    rotation = float(np.angle(np.vdot(position, true_position)))
    rotated = float(np.abs(position * np.exp(1j * rotation) - true_position).max())
    final, rms, largest, rotated_percent = (100.0 * value / path for value in (*errors, rotated))
    return Score(*errors, final, rms, largest, heading_rms, rotation, rotated, rotated_percent)


def format_error(error: float, percent: float | None, suffix: str = "") -> str:
    """Return an error as text in m and in % of the path; `suffix` follows the per cent sign."""
    percent_text = "the vehicle does not move" if percent is None else f"{percent:.2f} %{suffix}"
    return f"{error:.3f} m, {percent_text}"


@dataclass(frozen=True, slots=True)
class GnssOutage:
    """A time without GNSS fixes, and the position error accumulated in it.

    Attributes
    ----------
    start, end : s, times of the last fix before and the first fix after.
    distance : m driven in between.
    sigma : m, 1 sigma of the position at the end.
    error, percent : position error at the end, m and % of the distance; None without truth.
    worst : largest position error within the outage, m; None without truth.
    """

    start: float
    end: float
    distance: float
    sigma: float
    error: float | None
    percent: float | None
    worst: float | None


def find_gnss_outages(
    track: Track, fix_t: Array, truth: tuple[Array, Array, Array] | None = None, min_duration: float = 10.0
) -> tuple[GnssOutage, ...]:
    """Return the outages of more than `min_duration` seconds within a track.

    fix_t: (M,) s, times of the fixes that were used. truth: t (s), x and y (m), each (K,), in the axes of the
    track; it is shifted onto the track by the mean offset while there are fixes, never rotated.
    """
    gaps = np.flatnonzero(np.diff(fix_t) > min_duration)
    dx = dy = None
    if truth is not None:
        dx = track.x - np.interp(track.t, truth[0], truth[1])
        dy = track.y - np.interp(track.t, truth[0], truth[2])
        in_truth = (track.t >= truth[0][0]) & (track.t <= truth[0][-1])
        next_fix = np.clip(np.searchsorted(fix_t, track.t), 1, len(fix_t) - 1)
        has_fixes = in_truth & (fix_t[next_fix] - fix_t[next_fix - 1] <= min_duration)
        has_fixes = has_fixes if has_fixes.any() else in_truth
        if has_fixes.any():
            dx, dy = dx - dx[has_fixes].mean(), dy - dy[has_fixes].mean()
    outages = []
    for gap in gaps:
        start, end = float(fix_t[gap]), float(fix_t[gap + 1])
        inside = np.flatnonzero((track.t >= start) & (track.t <= end))
        if len(inside) < 2:
            continue
        distance = float(np.hypot(np.diff(track.x[inside]), np.diff(track.y[inside])).sum())
        sigma = float(np.hypot(track.sigma_x[inside[-1]], track.sigma_y[inside[-1]]))
        error = percent = worst = None
        if dx is not None and dy is not None:
            error_in_outage = np.hypot(dx[inside], dy[inside])
            error, worst = float(error_in_outage[-1]), float(error_in_outage.max())
            percent = 100.0 * error / distance if distance > 0.0 else None
        outages.append(GnssOutage(start, end, distance, sigma, error, percent, worst))
    return tuple(outages)
