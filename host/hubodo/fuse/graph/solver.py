"""Maximum a posteriori poses and constants of a factor graph whose poses form a chain."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.graph.chain import solve_chain
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.constants import COUNT, ConstantsFactor
from hubodo.fuse.graph.factors.heading import HeadingFactors
from hubodo.fuse.graph.factors.linear import QUADRATIC, Linear, Loss
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.factors.start import StartFactor

_MOST = 60
_NEAR = np.array([1e-4, 1e-4, 1e-6])
_STEEP = 1e9
_PORTION = 1024
"""Factors multiplied at a time: what is made of them stays in the processor's cache."""


@dataclass(frozen=True, slots=True)
class Losses:
    """What each kind of measurement may be: of three rows, two and one."""

    between: Loss = field(default=Loss("huber", 25.0))
    position: Loss = field(default=Loss("bounded", 12.0))
    heading: Loss = field(default=Loss("bounded", 9.0))


@dataclass(frozen=True, eq=False)
class Graph:
    """All factors. positions and headings have at most one factor per pose and may be None."""

    between: BetweenFactors
    start: StartFactor
    constants: ConstantsFactor
    positions: PositionFactors | None = None
    headings: HeadingFactors | None = None
    losses: Losses = field(default_factory=Losses)

    def linear(self, poses: Array, constants: Array) -> list[tuple[Linear, Loss]]:
        """Every kind of factor about poses (n, 3) and constants (6,)."""
        made = [
            (self.between.linear(poses, constants), self.losses.between),
            (self.start.linear(poses), QUADRATIC),
            (self.constants.linear(constants), QUADRATIC),
        ]
        if self.positions is not None:
            made.append((self.positions.linear(poses, constants), self.losses.position))
        if self.headings is not None:
            made.append((self.headings.linear(poses, constants), self.losses.heading))
        return made

    def cost(self, poses: Array, constants: Array) -> float:
        """What the solution minimises: robust losses, half of the squares."""
        return _cost(self.linear(poses, constants))


@dataclass(frozen=True, eq=False)
class Solution:
    """poses: (n, 3) x, y, heading; constants: (6,). covariance: (n, 3, 3) of each pose, start_covariance:
    (n, 3, 3) of pose k with pose 0, constants_covariance: (6, 6); empty unless asked for. iterations: taken;
    converged: before the most allowed."""

    poses: Array
    constants: Array
    cost: float
    iterations: int
    converged: bool
    covariance: Array
    start_covariance: Array
    constants_covariance: Array


def solve(
    graph: Graph, poses: Array, constants: Array, covariance: Literal["none", "constants", "all"] = "none"
) -> Solution:
    """From a first guess, by Gauss-Newton with iteratively reweighted losses, damped (Levenberg) where a
    step fails.

    Raises InputError when the equations are singular, which a start factor on every drive rules out but for
    numbers beyond reason.
    """
    damping, cost, linear = 0.0, np.inf, graph.linear(poses, constants)
    cost = _cost(linear)
    converged, count = False, 0
    while count < _MOST and not converged:
        count += 1
        step, change = _step(linear, len(poses), damping)
        new_poses, new_constants = poses + step, constants + change
        tried = graph.linear(new_poses, new_constants)
        new_cost = _cost(tried)
        small = bool(np.all(np.abs(step) < _NEAR))
        if new_cost <= cost * (1.0 + 1e-9) + 1e-9:
            converged = small or (damping == 0.0 and cost - new_cost < 1e-7 * (1.0 + cost))
            poses, constants, cost, linear = new_poses, new_constants, new_cost, tried
            damping = 0.0 if damping < 1e-6 else damping * 0.1
        elif damping > _STEEP or small:
            converged = True
        else:
            damping = max(damping * 10.0, 1e-4)
    nothing = np.zeros((0, 3, 3))
    made = Solution(poses, constants, cost, count, converged, nothing, nothing, np.zeros((0, COUNT)))
    if covariance == "none":
        return made
    of_poses, with_start, of_constants = _covariances(linear, len(poses), covariance == "all")
    return replace(made, covariance=of_poses, start_covariance=with_start, constants_covariance=of_constants)


def solve_from_afar(graph: Graph, poses: Array, constants: Array) -> Solution:
    """As `solve`, at first with losses under which a fix far off still pulls, so that a poor guess is not
    kept."""
    gentle = replace(graph, losses=Losses(graph.losses.between, Loss("huber", 4.0), Loss("huber", 4.0)))
    first = solve(gentle, poses, constants)
    return solve(graph, first.poses, first.constants)


def _cost(linear: list[tuple[Linear, Loss]]) -> float:
    return sum(float(loss.costs(_squares(item)).sum()) for item, loss in linear)


def _squares(item: Linear) -> Array:
    return np.asarray(np.einsum("ij,ij->i", item.residual, item.residual))


@dataclass
class _Normal:
    """H of the poses (diagonal, upper), its border with the constants, their own corner, and gradients."""

    diagonal: Array
    upper: Array
    border: Array
    corner: Array
    slope: Array
    corner_slope: Array


def _normal(linear: list[tuple[Linear, Loss]], n: int) -> _Normal:
    made = _Normal(
        np.zeros((n, 3, 3)),
        np.zeros((n - 1, 3, 3)),
        np.zeros((n, 3, COUNT)),
        np.zeros((COUNT, COUNT)),
        np.zeros((n, 3)),
        np.zeros(COUNT),
    )
    for item, loss in linear:
        root = np.sqrt(loss.weight(_squares(item)))[:, None, None]
        parts = [item.by_state, item.by_constants, item.residual[:, :, None]]
        if item.by_next is not None:
            parts.append(item.by_next)
        for first in range(0, len(root), _PORTION):
            part = slice(first, first + _PORTION)
            rows = np.concatenate([block[part] for block in parts], axis=2) * root[part]
            _add(made, item.state[part], rows)
    return made


def _add(made: _Normal, state: NDArray[np.intp], rows: Array) -> None:
    """rows: (m, r, 10 or 13), weighted: by the pose, the constants, the residual, and by the next pose."""
    square = rows.transpose(0, 2, 1) @ rows
    k, after = _places(state)
    made.diagonal[k] += square[:, :3, :3]
    made.border[k] += square[:, :3, 3:9]
    made.slope[k] += square[:, :3, 9]
    common = rows[:, :, 3:10].reshape(-1, COUNT + 1)
    corner = common.T @ common
    made.corner += corner[:6, :6]
    made.corner_slope += corner[:6, 6]
    if rows.shape[2] > 10:
        made.diagonal[after] += square[:, 10:, 10:]
        made.upper[k] += square[:, :3, 10:]
        made.border[after] += square[:, 10:, 3:9]
        made.slope[after] += square[:, 10:, 9]


def _places(state: NDArray[np.intp]) -> tuple[NDArray[np.intp] | slice, NDArray[np.intp] | slice]:
    """The poses of factors and the ones after them; as slices, which numpy adds to in less time, where every
    pose of a stretch has a factor."""
    if len(state) and np.array_equal(state, np.arange(state[0], state[0] + len(state))):
        first, end = int(state[0]), int(state[0]) + len(state)
        return slice(first, end), slice(first + 1, end + 1)
    return state, state + 1


def _step(linear: list[tuple[Linear, Loss]], n: int, damping: float) -> tuple[Array, Array]:
    h = _normal(linear, n)
    if damping > 0.0:
        grow = damping * np.einsum("kii->ki", h.diagonal)
        np.einsum("kii->ki", h.diagonal)[...] += grow
        h.corner[np.diag_indices(COUNT)] *= 1.0 + damping
    right = np.concatenate([-h.slope[:, :, None], -h.border], axis=2)
    try:
        x = solve_chain(h.diagonal, h.upper, right).x
        bare, swing = x[:, :, 0], x[:, :, 1:]
        corner = h.corner + np.tensordot(h.border, swing, ((0, 1), (0, 1)))
        slope = -h.corner_slope - np.tensordot(h.border, bare, ((0, 1), (0, 1)))
        change = np.linalg.solve(corner, slope)
    except np.linalg.LinAlgError:
        raise InputError(
            "odometry, fixes and headings do not determine a track; check their sigmas"
        ) from None
    return bare + swing @ change, np.asarray(change)


def _covariances(linear: list[tuple[Linear, Loss]], n: int, of_poses: bool) -> tuple[Array, Array, Array]:
    """Blocks of the inverse of the bordered matrix: those of the chain, and what the constants add."""
    h = _normal(linear, n)
    if not of_poses:
        swing = solve_chain(h.diagonal, h.upper, -h.border).x
        corner = h.corner + np.tensordot(h.border, swing, ((0, 1), (0, 1)))
        nothing = np.zeros((0, 3, 3))
        return nothing, nothing, np.asarray(np.linalg.inv(corner))
    first = np.zeros((n, 3, 3))
    first[0] = np.eye(3)
    found = solve_chain(h.diagonal, h.upper, np.concatenate([-h.border, first], axis=2), covariance=True)
    swing, from_start = found.x[:, :, :COUNT], found.x[:, :, COUNT:]
    constants = np.linalg.inv(h.corner + np.tensordot(h.border, swing, ((0, 1), (0, 1))))
    spread = swing @ constants
    return (
        found.covariance + spread @ swing.transpose(0, 2, 1),
        from_start + spread @ swing[0].T,
        np.asarray(constants),
    )
