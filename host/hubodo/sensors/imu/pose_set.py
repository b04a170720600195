"""A set of poses judged before it is solved: what it can show, what not, and which pose would help."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

PARAMETERS = (
    "bias x", "bias y", "bias z", "scale x", "scale y", "scale z", "xz - yz", "zy - xy", "yx - zx",
)  # fmt: skip
"""What the columns of the scalar method's matrix belong to, in the order of Avrutov, eq. 5."""


@dataclass(frozen=True)
class Factory:
    """What is known of a triad before it is measured, 1 sigma, relative to the reference.

    bias: of each axis. rest: of scale errors, and of differences of two angles.
    """

    bias: float
    rest: float = 0.03

    @property
    def sigma(self) -> Array:
        """(9,) of `PARAMETERS`."""
        return np.array([self.bias] * 3 + [self.rest] * 6)


ACCELEROMETER = Factory(bias=0.1)
"""Data sheets promise 1 to 3 % of scale (MPU-6050: 3 %, LSM6DS33 and LSM6DSO: 1 %), 1 to 2 % of one axis in
another, and 20 to 80 mg of offset.
"""
ANY_TRIAD = Factory(bias=1.0)
"""A gyro's bias may be as large as Earth rate; with a larger one the vector would not be as long as it."""
SEEN = 0.01
"""Relative to the reference: what a set of poses knows no better than that, it does not show.

A third of what the factory left. Nobody would turn a wheel by a scale of 1 %.
"""
NOISE_FLOOR = 1e-6
"""Relative to the reference: no set is judged by less noise than that, however many digits a record has."""
_MAX_SUGGESTIONS = 8


@dataclass(frozen=True)
class PoseSet:
    """The verdict on R poses.

    condition: ratio of the largest to the smallest singular value of the matrix. sigma: (9,) what each
    parameter is known to after the poses, relative to the reference.
    unseen: names of the parameters that are known no better than `SEEN`. suggestions: where "up" (the
    measured vector) should point in the node in further poses, best first.
    """

    count: int
    condition: float
    sigma: Array
    unseen: tuple[str, ...]
    suggestions: tuple[str, ...]

    @property
    def sufficient(self) -> bool:
        """Whether all nine parameters can be determined."""
        return not self.unseen

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(9,) which parameters can be determined."""
        return np.array([name not in self.unseen for name in PARAMETERS])

    def complaint(self, triad: str) -> str:
        """One line that says what is missing, for a set that is not sufficient."""
        helps = "; ".join(self.suggestions) or "no single pose helps: average longer in each"
        return (
            f"the {self.count} poses cannot show {', '.join(self.unseen)} of the {triad} triad "
            f"(condition number {self.condition:.2g}); what would help: {helps}"
        )


def design(v: Array, w: Array | None = None) -> Array:
    """(R, 9) matrix of Avrutov, eq. 5: rows [wx, wy, wz, wx², wy², wz², wx wy, wx wz, wy wz] of unit vectors.

    With `v` and `w` apart, the derivative of |w|²/2 for an error matrix that is not small: v = M^-T w, and w
    the corrected measurement; both (R, 3). For M = I they are equal and the row is the paper's.
    """
    if w is None:
        w = v
    cross = [(v[:, i] * w[:, j] + v[:, j] * w[:, i]) / 2 for i, j in ((0, 1), (0, 2), (1, 2))]
    return np.column_stack([v, v * w, *cross])


def judge_poses(directions: Array, sigma: Array | float = 0.0, factory: Factory = ANY_TRIAD) -> PoseSet:
    """Judge unit vectors (R, 3) in node axes.

    sigma: noise of the norm in each pose, relative, (R,) or scalar.
    """
    rows = design(directions)
    noise = np.broadcast_to(np.maximum(np.asarray(sigma, float), NOISE_FLOOR), (len(rows),))
    weighted = rows / noise[:, None]
    known = np.sqrt(np.diag(posterior(weighted, factory)))
    unseen = tuple(name for name, s in zip(PARAMETERS, known, strict=True) if not s <= SEEN)
    wanted = _suggest(weighted, factory, float(np.median(noise))) if unseen else ()
    return PoseSet(len(rows), _condition(rows), known, unseen, wanted)


def posterior(weighted: Array, factory: Factory) -> Array:
    """(9, 9) covariance after poses whose rows (R, 9) are in units of their noise."""
    _, s, vt = np.linalg.svd(weighted * factory.sigma, full_matrices=True)
    values = np.append(s, np.zeros(9 - len(s)))
    half = vt.T / np.sqrt(values**2 + 1.0) * factory.sigma[:, None]
    return np.asarray(half @ half.T)


def _condition(rows: Array) -> float:
    padded = np.vstack([rows, np.zeros((max(0, 9 - len(rows)), 9))])
    s = np.linalg.svd(padded, compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > s[0] * 1e-15 else float("inf")


def _suggest(weighted: Array, factory: Factory, noise: float) -> tuple[str, ...]:
    """Faces, edges and corners that most reduce the trace of the covariance, taken one after the other."""
    corners = [np.array(c, float) for c in itertools.product((-1, 0, 1), repeat=3) if any(c)]
    corners.sort(key=lambda c: np.count_nonzero(c))
    candidates = [(c, design((c / np.linalg.norm(c))[None, :]) / noise) for c in corners]
    found: list[str] = []
    for _ in range(_MAX_SUGGESTIONS):
        after = [posterior(np.vstack([weighted, row]), factory) for _, row in candidates]
        best = int(np.argmin([np.trace(covariance) for covariance in after]))
        weighted = np.vstack([weighted, candidates[best][1]])
        found.append(_words(candidates[best][0]))
        if bool((np.diag(after[best]) <= SEEN**2).all()):
            break
    return tuple(dict.fromkeys(found))


def _words(corner: Array) -> str:
    axes = [f"{'+' if c > 0 else '-'}{'xyz'[i]}" for i, c in enumerate(corner) if c]
    if len(axes) == 1:
        return f"{axes[0]} straight up"
    return f"up midway between {', '.join(axes[:-1])} and {axes[-1]}"
