"""Maximum a posteriori poses and constants of a factor graph whose poses form a chain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.graph.chain import solve_chain
from hubodo.fuse.graph.factor_graph import FactorGraph, total_cost
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.factor import LinearisedFactors
from hubodo.fuse.graph.factors.loss import Loss

_MAX_SOLVER_STEPS = 60
"""Steps; a first guess that is any good takes five to ten."""
_STEP_TOLERANCE = np.array([1e-4, 1e-4, 1e-6])
"""m, m, rad: a step below a tenth of a millimetre changes nothing that anyone can measure."""
_GRAPH_COST_TOLERANCE = 1e-7
"""Of the cost: an undamped step that gains less has arrived."""
_COST_ROUNDING = 1e-9
"""Of the cost, by which rounding may make a step at the optimum look uphill."""
_MIN_DAMPING, _MAX_DAMPING = 1e-4, 1e9
"""Of the diagonal: the least damping that helps, and the most, beyond which no step is downhill."""
_FACTORS_PER_BLOCK = 1024
"""Factors multiplied at a time: what is made of them stays in the processor's cache."""
POSE_COLUMNS, CONSTANTS_COLUMNS = slice(0, 3), slice(3, 3 + N_CONSTANTS)
RESIDUAL_COLUMN, NEXT_POSE_COLUMNS = 3 + N_CONSTANTS, slice(4 + N_CONSTANTS, 7 + N_CONSTANTS)
"""Columns of a factor's rows as the solver lays them side by side."""
COMMON_COLUMNS = slice(CONSTANTS_COLUMNS.start, RESIDUAL_COLUMN + 1)
"""The columns that all poses share: the constants and the residual."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimum of a graph.

    poses: (n, 3) x, y, heading; constants: (COUNT,). covariance: (n, 3, 3) of each pose,
    start_covariance: (n, 3, 3) of pose k with pose 0, constants_covariance: (COUNT, COUNT); empty unless
    asked for. iterations: taken; converged: before the most allowed.
    """

    poses: Array
    constants: Array
    cost: float
    iterations: int
    converged: bool
    covariance: Array
    start_covariance: Array
    constants_covariance: Array


def solve_graph(
    graph: FactorGraph,
    poses: Array,
    constants: Array,
    covariance: Literal["none", "constants", "all"] = "none",
) -> Solution:
    """From a first guess, by Gauss-Newton with iteratively reweighted losses.

    Damped (Levenberg) where a step fails. Raises InputError when the equations are singular, which a start
    factor on every drive rules out but for numbers beyond reason.
    """
    damping, linear = 0.0, graph.linearise(poses, constants)
    cost = total_cost(linear)
    converged, count = False, 0
    while count < _MAX_SOLVER_STEPS and not converged:
        count += 1
        step, change = _solve_step(linear, len(poses), damping)
        new_poses, new_constants = poses + step, constants + change
        tried = graph.linearise(new_poses, new_constants)
        new_cost = total_cost(tried)
        small = bool(np.all(np.abs(step) < _STEP_TOLERANCE))
        if new_cost <= cost * (1.0 + _COST_ROUNDING) + _COST_ROUNDING:
            converged = small or (damping == 0.0 and cost - new_cost < _GRAPH_COST_TOLERANCE * (1.0 + cost))
            poses, constants, cost, linear = new_poses, new_constants, new_cost, tried
            damping = 0.0 if damping < 0.01 * _MIN_DAMPING else damping * 0.1
        elif damping > _MAX_DAMPING or small:
            converged = True
        else:
            damping = max(damping * 10.0, _MIN_DAMPING)
    nothing = np.zeros((0, 3, 3))
    made = Solution(poses, constants, cost, count, converged, nothing, nothing, np.zeros((0, N_CONSTANTS)))
    if covariance == "none":
        return made
    of_poses, with_start, of_constants = _compute_covariances(linear, len(poses), covariance == "all")
    return replace(made, covariance=of_poses, start_covariance=with_start, constants_covariance=of_constants)


def solve_from_poor_guess(graph: FactorGraph, poses: Array, constants: Array) -> Solution:
    """As `solve`, so that a poor guess is not kept.

    At first with losses under which a fix far off still pulls.
    """
    first = solve_graph(graph.with_losses(lambda factor: factor.loss.for_initial_guess()), poses, constants)
    return solve_graph(graph, first.poses, first.constants)


def weighted_rows(item: LinearisedFactors, loss: Loss) -> Iterator[tuple[NDArray[np.intp], Array]]:
    """Poses (m,) and rows (m, r, columns) of a kind, portion by portion.

    Each row is times the root of what it weighs; NEXT is there only for factors of two poses.
    """
    root = np.sqrt(loss.weight(item.squared_norms))[:, None, None]
    parts = [item.pose_jacobian, item.constants_jacobian, item.residual[:, :, None]]
    if item.next_pose_jacobian is not None:
        parts.append(item.next_pose_jacobian)
    for first in range(0, len(root), _FACTORS_PER_BLOCK):
        part = slice(first, first + _FACTORS_PER_BLOCK)
        yield item.pose_index[part], np.concatenate([block[part] for block in parts], axis=2) * root[part]


@dataclass
class _NormalEquations:
    """H of the poses (diagonal, upper), its border with the constants, their own corner, and gradients."""

    diagonal: Array
    upper: Array
    border: Array
    corner: Array
    slope: Array
    corner_slope: Array


def _assemble_equations(linear: list[tuple[LinearisedFactors, Loss]], n: int) -> _NormalEquations:
    made = _NormalEquations(
        np.zeros((n, 3, 3)),
        np.zeros((n - 1, 3, 3)),
        np.zeros((n, 3, N_CONSTANTS)),
        np.zeros((N_CONSTANTS, N_CONSTANTS)),
        np.zeros((n, 3)),
        np.zeros(N_CONSTANTS),
    )
    for item, loss in linear:
        for state, rows in weighted_rows(item, loss):
            _add_rows(made, state, rows)
    return made


def _add_rows(made: _NormalEquations, state: NDArray[np.intp], rows: Array) -> None:
    """Squares of rows (m, r, columns), weighted, onto the blocks of their poses."""
    square = rows.transpose(0, 2, 1) @ rows
    k, after = _pose_slices(state)
    made.diagonal[k] += square[:, POSE_COLUMNS, POSE_COLUMNS]
    made.border[k] += square[:, POSE_COLUMNS, CONSTANTS_COLUMNS]
    made.slope[k] += square[:, POSE_COLUMNS, RESIDUAL_COLUMN]
    common = rows[:, :, COMMON_COLUMNS].reshape(-1, N_CONSTANTS + 1)
    corner = common.T @ common
    made.corner += corner[:N_CONSTANTS, :N_CONSTANTS]
    made.corner_slope += corner[:N_CONSTANTS, N_CONSTANTS]
    if rows.shape[2] == NEXT_POSE_COLUMNS.stop:
        made.diagonal[after] += square[:, NEXT_POSE_COLUMNS, NEXT_POSE_COLUMNS]
        made.upper[k] += square[:, POSE_COLUMNS, NEXT_POSE_COLUMNS]
        made.border[after] += square[:, NEXT_POSE_COLUMNS, CONSTANTS_COLUMNS]
        made.slope[after] += square[:, NEXT_POSE_COLUMNS, RESIDUAL_COLUMN]


def _pose_slices(state: NDArray[np.intp]) -> tuple[NDArray[np.intp] | slice, NDArray[np.intp] | slice]:
    """The poses of factors and the ones after them.

    As slices, which numpy adds to in less time, where every pose of a stretch has a factor: states increase.
    """
    if len(state) and state[-1] - state[0] == len(state) - 1:
        first, end = int(state[0]), int(state[0]) + len(state)
        return slice(first, end), slice(first + 1, end + 1)
    return state, state + 1


def _solve_step(linear: list[tuple[LinearisedFactors, Loss]], n: int, damping: float) -> tuple[Array, Array]:
    h = _assemble_equations(linear, n)
    if damping > 0.0:
        grow = damping * np.einsum("kii->ki", h.diagonal)
        np.einsum("kii->ki", h.diagonal)[...] += grow
        h.corner[np.diag_indices(N_CONSTANTS)] *= 1.0 + damping
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


def _compute_covariances(
    linear: list[tuple[LinearisedFactors, Loss]], n: int, of_poses: bool
) -> tuple[Array, Array, Array]:
    """Blocks of the inverse of the bordered matrix: those of the chain, and what the constants add."""
    h = _assemble_equations(linear, n)
    if not of_poses:
        swing = solve_chain(h.diagonal, h.upper, -h.border).x
        corner = h.corner + np.tensordot(h.border, swing, ((0, 1), (0, 1)))
        nothing = np.zeros((0, 3, 3))
        return nothing, nothing, np.asarray(np.linalg.inv(corner))
    first = np.zeros((n, 3, 3))
    first[0] = np.eye(3)
    found = solve_chain(h.diagonal, h.upper, np.concatenate([-h.border, first], axis=2), covariance=True)
    swing, from_start = found.x[:, :, :N_CONSTANTS], found.x[:, :, N_CONSTANTS:]
    constants = np.linalg.inv(h.corner + np.tensordot(h.border, swing, ((0, 1), (0, 1))))
    spread = swing @ constants
    return (
        found.covariance + spread @ swing.transpose(0, 2, 1),
        from_start + spread @ swing[0].T,
        np.asarray(constants),
    )
