"""A set of poses judged before it is solved: what it can show, what not, and which pose would help."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PARAMETERS = (
    "bias x", "bias y", "bias z", "scale x", "scale y", "scale z", "xz - yz", "zy - xy", "yx - zx",
)  # fmt: skip
"""What the columns of the scalar method's matrix belong to, in the order of Avrutov, eq. 5."""

CONDITION_LIMIT = 5e4
"""Condition beyond which the set counts as degenerate whatever the noise.

The nine poses that the paper gives as good have about 7e3, exactly degenerate ones 1e8 and more.
"""
SIGMA_LIMIT = 0.02
"""Relative to the reference; a parameter known no better is unknown: chips leave the factory so."""
_MAX_SUGGESTIONS = 8


@dataclass(frozen=True)
class PoseSet:
    """The verdict on R poses.

    condition: ratio of the largest to the smallest singular value of the matrix. amplification: (9,) 1 sigma
    of each parameter for unit noise in every pose (infinite where unseen). sigma: (9,) the same for the
    noise at hand, relative to the reference. unseen: names of parameters that cannot be determined.
    suggestions: where "up" (the measured vector) should point in the node in further poses, best first.
    """

    count: int
    condition: float
    amplification: Array
    sigma: Array
    unseen: tuple[str, ...]
    suggestions: tuple[str, ...]

    @property
    def sufficient(self) -> bool:
        """Whether all nine parameters can be determined."""
        return not self.unseen

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


def judge_poses(directions: Array, sigma: Array | float = 0.0) -> PoseSet:
    """Judge unit vectors (R, 3) in node axes.

    sigma: noise of the norm in each pose, relative, (R,) or scalar.
    """
    rows = design(directions)
    noise = np.broadcast_to(np.asarray(sigma, float), (len(rows),))
    condition, amplification = _judge(rows)
    weighted = rows / np.where(noise > 0, noise, 1.0)[:, None]
    spread = _judge(weighted)[1] if bool((noise > 0).any()) else np.zeros(9)
    unseen = _unseen(rows, condition, spread)
    wanted = _suggest(rows, float(np.median(noise))) if unseen else ()
    return PoseSet(len(rows), condition, amplification, spread, unseen, wanted)


def _judge(rows: Array) -> tuple[float, Array]:
    """Condition number, and the standard deviation of each parameter for unit noise."""
    padded = np.vstack([rows, np.zeros((max(0, 9 - len(rows)), 9))])
    _, s, vt = np.linalg.svd(padded, full_matrices=False)
    if s[-1] <= s[0] * 1e-15:
        unseen = (vt[s <= s[0] * 1e-15] ** 2).sum(axis=0) > 1e-6
        seen = s > s[0] * 1e-15
        spread = np.sqrt(((vt[seen] / s[seen, None]) ** 2).sum(axis=0))
        return float("inf"), np.where(unseen, np.inf, spread)
    return float(s[0] / s[-1]), np.asarray(np.sqrt(((vt / s[:, None]) ** 2).sum(axis=0)))


def _unseen(rows: Array, condition: float, sigma: Array) -> tuple[str, ...]:
    blind = ~(sigma <= SIGMA_LIMIT)
    if condition > CONDITION_LIMIT or len(rows) < 9:
        padded = np.vstack([rows, np.zeros((max(0, 9 - len(rows)), 9))])
        _, s, vt = np.linalg.svd(padded, full_matrices=False)
        null = vt[s * CONDITION_LIMIT < s[0]]
        # A tenth of the weight of a null direction: less is only carried along by the others.
        blind = blind | ((null**2).max(axis=0, initial=0.0) > 0.01)
    return tuple(name for name, hidden in zip(PARAMETERS, blind, strict=True) if hidden)


def _suggest(rows: Array, noise: float) -> tuple[str, ...]:
    """Faces, edges and corners that most reduce the trace of the covariance, taken one after the other."""
    corners = [np.array(c, float) for c in itertools.product((-1, 0, 1), repeat=3) if any(c)]
    corners.sort(key=lambda c: np.count_nonzero(c))
    candidates = [(c, design((c / np.linalg.norm(c))[None, :])) for c in corners]
    found: list[str] = []
    information = rows.T @ rows
    for _ in range(_MAX_SUGGESTIONS):
        gains = [
            np.trace(np.linalg.inv(information + row.T @ row + 1e-9 * np.eye(9))) for _, row in candidates
        ]
        best = int(np.argmin(gains))
        information = information + candidates[best][1].T @ candidates[best][1]
        found.append(_words(candidates[best][0]))
        s = np.sqrt(np.maximum(np.linalg.eigvalsh(information), 0.0))
        if s[0] > s[-1] / 1e3 and noise < SIGMA_LIMIT * s[0]:
            break
    return tuple(dict.fromkeys(found))


def _words(corner: Array) -> str:
    axes = [f"{'+' if c > 0 else '-'}{'xyz'[i]}" for i, c in enumerate(corner) if c]
    if len(axes) == 1:
        return f"{axes[0]} straight up"
    return f"up midway between {', '.join(axes[:-1])} and {axes[-1]}"
