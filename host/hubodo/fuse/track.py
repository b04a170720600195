"""A fused track: poses with their sigmas over time, and how far they are from the truth where it is known."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.differential_odometry import OdometryState


def _empty() -> Array:
    return np.empty(0)


@dataclass(frozen=True, eq=False)
class Track:
    """Poses of the body origin, each (N,).

    Arrays that a source cannot give are empty: the odometry that a graph takes needs a path alone.

    Attributes
    ----------
    t : s on the log's clock, strictly increasing.
    x, y : m from the start.
    heading : rad, anticlockwise from x.
    speed : m/s, mean over the step that ends at t.
    sigma_x, sigma_y : m, 1 sigma, growing from zero at the start.
    sigma_heading : rad, 1 sigma.
    yaw_rate : rad/s, mean over the step that ends at t.
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
    step_inflation: Array = field(default_factory=_empty)

    @property
    def distance(self) -> float:
        """Length of the path, m."""
        return float(np.sum(np.hypot(np.diff(self.x), np.diff(self.y))))


@dataclass(frozen=True, slots=True)
class Score:
    """Distance of a track from the truth: m, the same in % of the path, and rad.

    The percentages are None where the truth does not move.
    """

    final_error: float
    rms_error: float
    maximum_error: float
    final_percent: float | None
    rms_percent: float | None
    maximum_percent: float | None
    heading_rms: float | None


def track_from_states(states: Sequence[OdometryState], heading: float = 0.0) -> Track:
    """The track of odometry states, turned so that it begins at `heading`, rad.

    Raises ValueError when there are no states.
    """
    if not states:
        raise ValueError("no poses: the two wheels have no time in common")
    pose = np.array([[s.t_ns * 1e-9, s.x, s.y, s.heading, s.speed, s.yaw_rate] for s in states])
    covariance = np.array([s.covariance for s in states])
    cos, sin = np.cos(heading), np.sin(heading)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    sigma = np.sqrt(np.maximum(np.einsum("ij,njk,ik->ni", turn, covariance, turn), 0.0))
    x, y = cos * pose[:, 1] - sin * pose[:, 2], sin * pose[:, 1] + cos * pose[:, 2]
    t, _, _, odometry_heading, speed, yaw_rate = pose.T
    sigma_x, sigma_y, sigma_heading = sigma.T
    return Track(t, x, y, odometry_heading + heading, speed, sigma_x, sigma_y, sigma_heading, yaw_rate)


def score_track(track: Track, t: Array, x: Array, y: Array, heading: Array | None) -> Score | None:
    """How far a track is from the truth (t, x, y, heading, each (M,)) over their common time.

    Both begin at the same point: the truth is shifted, never turned. None without common time.
    """
    common = (track.t >= t[0]) & (track.t <= t[-1])
    if np.count_nonzero(common) < 2:
        return None
    at = track.t[common]
    ex, ey = track.x[common] - np.interp(at, t, x), track.y[common] - np.interp(at, t, y)
    error = np.hypot(ex - ex[0], ey - ey[0])
    path = float(np.sum(np.hypot(np.diff(x), np.diff(y))))
    rms = float(np.sqrt(np.mean(error**2)))
    final, maximum = float(error[-1]), float(error.max())
    turn_rms = None
    if heading is not None:
        off = track.heading[common] - np.interp(at, t, np.unwrap(heading))
        turn_rms = float(np.sqrt(np.mean((np.mod(off + np.pi, 2 * np.pi) - np.pi) ** 2)))

    def percent(value: float) -> float | None:
        return 100.0 * value / path if path > 0.0 else None

    return Score(final, rms, maximum, percent(final), percent(rms), percent(maximum), turn_rms)


def format_error(error: float, percent: float | None, suffix: str = "") -> str:
    """Return an error in m and in % of the path; of: words behind the per cent sign."""
    share = "the vehicle does not move" if percent is None else f"{percent:.2f} %{suffix}"
    return f"{error:.3f} m, {share}"


@dataclass(frozen=True, slots=True)
class GnssOutage:
    """A time without fixes.

    start, end: s, of the fixes before and after. distance: m driven in it. sigma: m, 1 sigma of the
    position at its end. error, percent: m and % of the distance there, worst: m within it; None without
    truth.
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
    """Outages of more than `longest` seconds within a track.

    fix_t: (M,) s, fixes that counted. truth: t (s), x, y (m, (K,)) in axes of the track; it is shifted onto
    the track by the mean of both where there are fixes, never turned.
    """
    gaps = np.flatnonzero(np.diff(fix_t) > min_duration)
    dx = dy = None
    if truth is not None:
        dx = track.x - np.interp(track.t, truth[0], truth[1])
        dy = track.y - np.interp(track.t, truth[0], truth[2])
        known = (track.t >= truth[0][0]) & (track.t <= truth[0][-1])
        after = np.clip(np.searchsorted(fix_t, track.t), 1, len(fix_t) - 1)
        covered = known & (fix_t[after] - fix_t[after - 1] <= min_duration)
        covered = covered if covered.any() else known
        if covered.any():
            dx, dy = dx - dx[covered].mean(), dy - dy[covered].mean()
    found = []
    for gap in gaps:
        start, end = float(fix_t[gap]), float(fix_t[gap + 1])
        inside = np.flatnonzero((track.t >= start) & (track.t <= end))
        if len(inside) < 2:
            continue
        distance = float(np.hypot(np.diff(track.x[inside]), np.diff(track.y[inside])).sum())
        sigma = float(np.hypot(track.sigma_x[inside[-1]], track.sigma_y[inside[-1]]))
        error = percent = worst = None
        if dx is not None and dy is not None:
            off = np.hypot(dx[inside], dy[inside])
            error, worst = float(off[-1]), float(off.max())
            percent = 100.0 * error / distance if distance > 0.0 else None
        found.append(GnssOutage(start, end, distance, sigma, error, percent, worst))
    return tuple(found)
