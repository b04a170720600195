"""Observability of the calibration parameters for a set of poses, and suggestions for further poses."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

TRIAD_PARAMETERS = (
    "bias x", "bias y", "bias z", "scale x", "scale y", "scale z", "xz - yz", "zy - xy", "yx - zx",
)  # fmt: skip
"""Parameters of the columns of the design matrix, in the order of Avrutov, eq. 5."""


@dataclass(frozen=True)
class FactoryTolerance:
    """Factory tolerances of a triad: prior sigmas relative to the reference.

    Attributes:
        bias: sigma of the bias of each axis.
        scale_and_angle: sigma of scale errors, and of differences of two misalignment angles.
    """

    bias: float
    scale_and_angle: float = 0.03

    @property
    def sigma(self) -> Array:
        """Return the (9,) prior sigmas in the order of `TRIAD_PARAMETERS`."""
        return np.array([self.bias] * 3 + [self.scale_and_angle] * 6)


ACCELEROMETER_TOLERANCE = FactoryTolerance(bias=0.1)
"""Data sheets state scale errors of 1 to 3 % (MPU-6050: 3 %, LSM6DS33 and LSM6DSO: 1 %), cross-axis
sensitivities of 1 to 2 %, and offsets of 20 to 80 mg.
"""
WIDE_TOLERANCE = FactoryTolerance(bias=1.0)
"""The bias of a gyro may be as large as Earth rate; a larger one would dominate the norm of the vector."""
MAX_OBSERVABLE_SIGMA = 0.01
"""Sigma relative to the reference above which a parameter counts as unobservable: a third of the factory
tolerance.
"""
MIN_RELATIVE_NOISE = 1e-6
"""Smallest noise, relative to the reference, that is assumed for any record."""
_MAX_SUGGESTIONS = 8


@dataclass(frozen=True)
class PoseObservability:
    """The observability of the nine parameters in a set of poses.

    Attributes:
        count: number of poses.
        condition: condition number of the design matrix.
        sigma: (9,) posterior sigmas relative to the reference.
        unobservable: names of the parameters with a sigma above `MAX_OBSERVABLE_SIGMA`.
        suggestions: directions of "up" (the measured vector) in node axes for further poses, best first.
    """

    count: int
    condition: float
    sigma: Array
    unobservable: tuple[str, ...]
    suggestions: tuple[str, ...]

    @property
    def is_sufficient(self) -> bool:
        """Return True if all nine parameters can be determined."""
        return not self.unobservable

    @property
    def is_observable(self) -> NDArray[np.bool_]:
        """Return (9,) True for the parameters that can be determined."""
        return np.array([name not in self.unobservable for name in TRIAD_PARAMETERS])

    def describe_deficit(self, triad: str) -> str:
        """Return one line with the unobservable parameters and the poses that would determine them."""
        helps = "; ".join(self.suggestions) or "no single pose helps: average longer in each"
        poses = "a single pose does" if self.count == 1 else f"the {self.count} poses do"
        return (
            f"{poses} not determine {', '.join(self.unobservable)} of the {triad} triad "
            f"(condition number {self.condition:.2g}); further poses that would help: {helps}"
        )


def pose_design_matrix(v: Array, w: Array | None = None) -> Array:
    """Return the (R, 9) matrix of Avrutov, eq. 5: rows [wx, wy, wz, wx², wy², wz², wx wy, wx wz, wy wz].

    v, w: (R, 3) unit vectors. For an error matrix M that is not small, the rows are the derivative of
    |w|²/2, with v = M^-T w and w the corrected measurement. For M = I, v and w are equal and the row is that
    of the paper.
    """
    if w is None:
        w = v
    cross = [(v[:, i] * w[:, j] + v[:, j] * w[:, i]) / 2 for i, j in ((0, 1), (0, 2), (1, 2))]
    return np.column_stack([v, v * w, *cross])


def assess_poses(
    directions: Array, sigma: Array | float = 0.0, factory: FactoryTolerance = WIDE_TOLERANCE
) -> PoseObservability:
    """Assess the observability for poses given as unit vectors (R, 3) in node axes.

    sigma: relative noise of the norm in each pose, (R,) or scalar.
    """
    rows = pose_design_matrix(directions)
    noise = np.broadcast_to(np.maximum(np.asarray(sigma, float), MIN_RELATIVE_NOISE), (len(rows),))
    weighted = rows / noise[:, None]
    sigmas = np.sqrt(np.diag(posterior_covariance(weighted, factory)))
    unobservable = tuple(
        name for name, s in zip(TRIAD_PARAMETERS, sigmas, strict=True) if not s <= MAX_OBSERVABLE_SIGMA
    )
    suggestions = _suggest_poses(weighted, factory, float(np.median(noise))) if unobservable else ()
    return PoseObservability(len(rows), _condition_number(rows), sigmas, unobservable, suggestions)


def posterior_covariance(weighted: Array, factory: FactoryTolerance) -> Array:
    """Return the (9, 9) posterior covariance for design rows (R, 9) in units of their noise."""
    _, s, vt = np.linalg.svd(weighted * factory.sigma, full_matrices=True)
    values = np.append(s, np.zeros(9 - len(s)))
    square_root = vt.T / np.sqrt(values**2 + 1.0) * factory.sigma[:, None]
    return np.asarray(square_root @ square_root.T)


def _condition_number(rows: Array) -> float:
    padded = np.vstack([rows, np.zeros((max(0, 9 - len(rows)), 9))])
    s = np.linalg.svd(padded, compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > s[0] * 1e-15 else float("inf")


def _suggest_poses(weighted: Array, factory: FactoryTolerance, noise: float) -> tuple[str, ...]:
    """Return the faces, edges and corners that reduce the trace of the covariance most, chosen greedily."""
    candidates = [(c, pose_design_matrix((c / np.linalg.norm(c))[None, :]) / noise) for c in box_directions()]
    suggestions: list[str] = []
    for _ in range(_MAX_SUGGESTIONS):
        covariances = [posterior_covariance(np.vstack([weighted, row]), factory) for _, row in candidates]
        best = int(np.argmin([np.trace(covariance) for covariance in covariances]))
        weighted = np.vstack([weighted, candidates[best][1]])
        suggestions.append(describe_direction(candidates[best][0]))
        if bool((np.diag(covariances[best]) <= MAX_OBSERVABLE_SIGMA**2).all()):
            break
    return tuple(dict.fromkeys(suggestions))


def box_directions() -> list[Array]:
    """Return the directions, not normalised, from the centre of a box to its faces, edges and corners."""
    corners = [np.array(c, float) for c in itertools.product((-1, 0, 1), repeat=3) if any(c)]
    return sorted(corners, key=lambda c: np.count_nonzero(c))


def describe_direction(corner: Array) -> str:
    """Return a direction of `box_directions` in words."""
    axes = [f"{'+' if c > 0 else '-'}{'xyz'[i]}" for i, c in enumerate(corner) if c]
    if len(axes) == 1:
        return f"{axes[0]} straight up"
    return f"up midway between {', '.join(axes[:-1])} and {axes[-1]}"
