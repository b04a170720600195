"""A fused track: poses with their sigmas over time, and how far they are from the truth where it is known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.odometry import OdometryState


@dataclass(frozen=True, eq=False)
class Track:
    """Poses of the body origin, each (N,).

    t: s on the log's clock. x, y: m from the start, heading: rad, anticlockwise from x and unwrapped.
    speed: m/s. sigma_x, sigma_y: m; sigma_heading: rad; growing from zero at the start.
    """

    t: Array
    x: Array
    y: Array
    heading: Array
    speed: Array
    sigma_x: Array
    sigma_y: Array
    sigma_heading: Array

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


def from_states(states: Sequence[OdometryState], heading: float = 0.0) -> Track:
    """The track of odometry states, turned so that it begins at `heading`, rad.

    Raises ValueError when there are no states.
    """
    if not states:
        raise ValueError("no poses: the two wheels have no time in common")
    pose = np.array([[s.t_ns * 1e-9, s.x, s.y, s.heading, s.speed] for s in states])
    covariance = np.array([s.covariance for s in states])
    cos, sin = np.cos(heading), np.sin(heading)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    sigma = np.sqrt(np.maximum(np.einsum("ij,njk,ik->ni", turn, covariance, turn), 0.0))
    x, y = cos * pose[:, 1] - sin * pose[:, 2], sin * pose[:, 1] + cos * pose[:, 2]
    return Track(pose[:, 0], x, y, pose[:, 3] + heading, pose[:, 4], *sigma.T)


def score(track: Track, t: Array, x: Array, y: Array, heading: Array | None) -> Score | None:
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


def error_words(error: float, percent: float | None, of: str = "") -> str:
    """Return an error in m and in % of the path; of: words behind the per cent sign."""
    share = "the vehicle does not move" if percent is None else f"{percent:.2f} %{of}"
    return f"{error:.3f} m, {share}"
