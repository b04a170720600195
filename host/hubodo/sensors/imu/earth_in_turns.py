"""Earth rate in the turns between standstills, estimated where the gyros do not measure it at rest.

Gyros measure rates relative to inertial space. While a turn lasts T, the Earth turns the vertical by
T (omega x up), with omega the Earth's rate, so gravity propagated by the gyros misses measured gravity by
C' (up x omega) T, with C the attitude (node to world) after the turn. The heading of the first pose is
unknown, but turns carry it from pose to pose. So the horizontal part of omega, in axes of the first pose, is
two more unknowns for all turns together; after a turn that lost the heading, two new ones follow. The
vertical part does not move gravity. It follows from the latitude, or its spread enters the bias sigma.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.earth import EARTH_RATE
from hubodo.sensors.imu.turn_calibration import TurnCalibration, calibrate_from_turns
from hubodo.sensors.imu.turns import Turns, turn_rotations

_MAX_LOST_TURN_ERROR = 0.3
"""rad; a turn with a larger misclosure does not carry the heading on."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class EarthInTurns:
    """The Earth's rate in R standstills, and its effect on the T turns between them.

    Attributes:
        turns: the turns with their derivatives by the horizontal Earth rate.
        columns, unknowns, covariance: (R, 3, U) derivatives of the Earth rate in node axes by the unknowns,
            their values (U,), rad/s, and covariance.
        horizontal: horizontal Earth rate of the longest section, rad/s, and its 1σ.
    """

    turns: Turns
    columns: Array
    unknowns: Array
    covariance: Array
    horizontal: tuple[float, float]

    @property
    def rates(self) -> Array:
        """Return the (R, 3) Earth rates in node axes, rad/s."""
        return np.asarray(self.columns @ self.unknowns)

    def bias_covariance(self, static: Array, design: Array, floor: Array) -> Array:
        """Return the (3, 3) covariance of a bias, with the errors of the Earth rate in their place.

        static: (3, 3) diagonal covariance by the scatter of the standstills, which these errors increase as
        well. design: (R, P) columns of the regression whose first coefficient is the bias. floor: (3,)
        variance by noise alone.
        """
        inverse = np.linalg.pinv(design)
        dof = len(design) - design.shape[1]
        effect = np.einsum("r,rku->ku", inverse[0], self.columns)
        residual = self.columns - np.einsum("rs,sku->rku", design @ inverse, self.columns)
        scatter = np.einsum("rku,uv,rkv->k", residual, self.covariance, residual) / dof
        scatter *= float(inverse[0] @ inverse[0])
        noise = np.maximum(np.diag(static) - scatter, floor * float(inverse[0] @ inverse[0]))
        return np.asarray(np.diag(noise) + effect @ self.covariance @ effect.T)


def estimate_earth_in_turns(turns: Turns, bias_sigma: Array, latitude: float | None) -> EarthInTurns:
    """Estimate the Earth's rate from the misclosures of all turns.

    turns: all T turns between R = T + 1 standstills. bias_sigma: (3,) rad/s. latitude: rad, or None.
    Raises CalibrationError like `calibrate_from_turns`.
    """
    matrix, change = np.eye(3), np.zeros(3)
    for _ in range(2):
        attitudes, section = _propagate_attitudes(turns, matrix, change)
        turns = _with_earth(turns, attitudes, section)
        calibration = calibrate_from_turns(turns, bias_sigma)
        matrix, change = calibration.matrix, calibration.bias_change
    vertical = 0.0 if latitude is None else EARTH_RATE * math.sin(latitude)
    # Unknowns: horizontal rate of each section, then the vertical rate.
    unknowns = np.append(calibration.earth_rate, vertical)
    columns = _node_columns(attitudes, section)
    covariance = np.zeros((len(unknowns), len(unknowns)))
    covariance[:-1, :-1] = calibration.earth_covariance
    covariance[-1, -1] = EARTH_RATE**2 / 3.0 if latitude is None else 0.0
    return EarthInTurns(turns, columns, unknowns, covariance, _horizontal_rate(calibration, section))


def _propagate_attitudes(turns: Turns, matrix: Array, change: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the (R, 3, 3) attitudes of the standstills (node to world), and the section of each.

    Within a section, headings refer to its first standstill.
    """
    up = np.vstack([turns.start, turns.end[-1:]])
    rotations = turn_rotations(turns, matrix, change)
    attitudes, section = [_level(up[0])], [0]
    for k, rotation in enumerate(rotations):
        after = attitudes[-1] @ rotation
        measured = after @ up[k + 1]
        if turns.defect[k] or measured @ _UP < math.cos(_MAX_LOST_TURN_ERROR):
            attitudes.append(_level(up[k + 1]))
            section.append(section[-1] + 1)
        else:
            attitudes.append(_shortest_rotation(measured, _UP) @ after)
            section.append(section[-1])
    return np.array(attitudes), np.array(section)


def _with_earth(turns: Turns, attitudes: Array, section: NDArray[np.int64]) -> Turns:
    count = int(section[-1]) + 1
    duration = turns.dt.sum(axis=1)
    slopes = np.zeros((len(duration), 3, 2 * count))
    # C' (up x omega) T for omega along the two horizontal axes.
    for axis, direction in enumerate(np.eye(3)[:2]):
        effect = np.cross(_UP, direction) @ attitudes[1:] * duration[:, None]
        slopes[np.arange(len(duration)), :, 2 * section[1:] + axis] = effect
    # The prior is that of an unknown latitude: a wrong latitude must not hide the measured rate.
    return replace(turns, earth_slopes=slopes, earth_sigma=EARTH_RATE / math.sqrt(3.0))


def _node_columns(attitudes: Array, section: NDArray[np.int64]) -> Array:
    """Return the (R, 3, 2 S + 1) derivatives of the Earth rate in node axes by the unknowns."""
    count = int(section[-1]) + 1
    columns = np.zeros((len(attitudes), 3, 2 * count + 1))
    rows = np.arange(len(attitudes))
    for axis in range(2):
        columns[rows, :, 2 * section + axis] = attitudes[:, axis]
    columns[:, :, -1] = attitudes[:, 2]
    return columns


def _horizontal_rate(calibration: TurnCalibration, section: NDArray[np.int64]) -> tuple[float, float]:
    longest = int(np.argmax(np.bincount(section)))
    rows = slice(2 * longest, 2 * longest + 2)
    vector, covariance = calibration.earth_rate[rows], calibration.earth_covariance[rows, rows]
    size = float(np.linalg.norm(vector))
    direction = vector / max(size, 1e-300)
    return size, math.sqrt(float(direction @ covariance @ direction))


def _level(up: Array) -> Array:
    """Return an attitude (node to world) with `up` (3,) in node axes along the vertical."""
    return _shortest_rotation(up, _UP)


def _shortest_rotation(a: Array, b: Array) -> Array:
    """Return the (3, 3) rotation by the smallest angle that turns unit vector a (3,) onto b (3,)."""
    axis, cosine = np.cross(a, b), float(a @ b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0]) @ np.eye(3)
    return np.asarray(Rotation.from_rotvec(axis / sine * math.atan2(sine, cosine)).as_matrix())
