"""Maximum a posteriori solver for the poses and constants of a factor graph whose poses form a chain."""

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
"""Iterations; from a reasonable initial guess it takes five to ten."""
_STEP_TOLERANCE = np.array([1e-4, 1e-4, 1e-6])
"""m, m, rad: a smaller step, below a tenth of a millimetre, ends the iterations."""
_GRAPH_COST_TOLERANCE = 1e-7
"""Fraction of the cost: an undamped step that gains less has converged."""
_COST_ROUNDING = 1e-9
"""Fraction of the cost by which rounding may raise it at the optimum."""
_MIN_DAMPING, _MAX_DAMPING = 1e-4, 1e9
"""Fractions of the diagonal: the least damping that has an effect, and that beyond which no step descends."""
_FACTORS_PER_BLOCK = 1024
"""Factors multiplied at a time, so that the products stay in the processor's cache."""
POSE_COLUMNS, CONSTANTS_COLUMNS = slice(0, 3), slice(3, 3 + N_CONSTANTS)
RESIDUAL_COLUMN, NEXT_POSE_COLUMNS = 3 + N_CONSTANTS, slice(4 + N_CONSTANTS, 7 + N_CONSTANTS)
"""Columns of a factor's rows as the solver concatenates them."""
COMMON_COLUMNS = slice(CONSTANTS_COLUMNS.start, RESIDUAL_COLUMN + 1)
"""The columns that all poses share: the constants and the residual."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimum of a graph.

    Attributes
    ----------
    poses : (n, 3) x, y, heading.
    constants : (N_CONSTANTS,).
    cost : cost at the optimum.
    iterations : number of iterations.
    converged : whether the iterations ended before their maximum number.
    covariance : (n, 3, 3) of each pose; empty unless asked for.
    start_covariance : (n, 3, 3) of pose k with pose 0; empty unless asked for.
    constants_covariance : (N_CONSTANTS, N_CONSTANTS); empty unless asked for.
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
    """Solve from an initial guess, by Gauss-Newton with iteratively reweighted losses.

    Steps are damped (Levenberg) where they fail. Raises InputError when the equations are singular, which the
    prior of the first pose excludes for all but absurd numbers.
    """
    damping, linearised = 0.0, graph.linearise(poses, constants)
    cost = total_cost(linearised)
    converged, iteration = False, 0
    while iteration < _MAX_SOLVER_STEPS and not converged:
        iteration += 1
        step, constants_step = _solve_step(linearised, len(poses), damping)
        new_poses, new_constants = poses + step, constants + constants_step
        new_linearised = graph.linearise(new_poses, new_constants)
        new_cost = total_cost(new_linearised)
        is_small = bool(np.all(np.abs(step) < _STEP_TOLERANCE))
        if new_cost <= cost * (1.0 + _COST_ROUNDING) + _COST_ROUNDING:
            converged = is_small or (
                damping == 0.0 and cost - new_cost < _GRAPH_COST_TOLERANCE * (1.0 + cost)
            )
            poses, constants, cost, linearised = new_poses, new_constants, new_cost, new_linearised
            damping = 0.0 if damping < 0.01 * _MIN_DAMPING else damping * 0.1
        elif damping > _MAX_DAMPING or is_small:
            converged = True
        else:
            damping = max(damping * 10.0, _MIN_DAMPING)
    no_covariance = np.zeros((0, 3, 3))
    solution = Solution(
        poses, constants, cost, iteration, converged, no_covariance, no_covariance, np.zeros((0, N_CONSTANTS))
    )
    if covariance == "none":
        return solution
    pose_covariance, start_covariance, constants_covariance = _compute_covariances(
        linearised, len(poses), covariance == "all"
    )
    return replace(
        solution,
        covariance=pose_covariance,
        start_covariance=start_covariance,
        constants_covariance=constants_covariance,
    )


def solve_from_poor_guess(graph: FactorGraph, poses: Array, constants: Array) -> Solution:
    """Solve first with losses under which distant fixes still pull, then as `solve_graph`."""
    first = solve_graph(graph.with_losses(lambda factor: factor.loss.for_initial_guess()), poses, constants)
    return solve_graph(graph, first.poses, first.constants)


def weighted_rows(factors: LinearisedFactors, loss: Loss) -> Iterator[tuple[NDArray[np.intp], Array]]:
    """Yield poses (m,) and rows (m, r, columns) of one kind of factor, block by block.

    Each row is multiplied by the root of its weight; NEXT_POSE_COLUMNS exist only for factors of two poses.
    """
    weight_root = np.sqrt(loss.weight(factors.squared_norms))[:, None, None]
    columns = [factors.pose_jacobian, factors.constants_jacobian, factors.residual[:, :, None]]
    if factors.next_pose_jacobian is not None:
        columns.append(factors.next_pose_jacobian)
    for first in range(0, len(weight_root), _FACTORS_PER_BLOCK):
        rows = slice(first, first + _FACTORS_PER_BLOCK)
        yield (
            factors.pose_index[rows],
            np.concatenate([block[rows] for block in columns], axis=2) * weight_root[rows],
        )


@dataclass
class _NormalEquations:
    """Blocks of the normal equations.

    Attributes
    ----------
    diagonal, upper : (n, 3, 3) and (n - 1, 3, 3), blocks of the poses.
    border : (n, 3, N_CONSTANTS), poses by constants.
    corner : (N_CONSTANTS, N_CONSTANTS).
    slope, corner_slope : gradients by poses and constants.
    """

    diagonal: Array
    upper: Array
    border: Array
    corner: Array
    slope: Array
    corner_slope: Array


def _assemble_equations(linearised: list[tuple[LinearisedFactors, Loss]], n: int) -> _NormalEquations:
    """Return the normal equations of linearised factors for n poses."""
    equations = _NormalEquations(
        np.zeros((n, 3, 3)),
        np.zeros((n - 1, 3, 3)),
        np.zeros((n, 3, N_CONSTANTS)),
        np.zeros((N_CONSTANTS, N_CONSTANTS)),
        np.zeros((n, 3)),
        np.zeros(N_CONSTANTS),
    )
    for factors, loss in linearised:
        for pose_index, rows in weighted_rows(factors, loss):
            _add_rows(equations, pose_index, rows)
    return equations


def _add_rows(equations: _NormalEquations, pose_index: NDArray[np.intp], rows: Array) -> None:
    """Add the squares of weighted rows (m, r, columns) to the blocks of their poses."""
    products = rows.transpose(0, 2, 1) @ rows
    at_pose, at_next_pose = _pose_slices(pose_index)
    equations.diagonal[at_pose] += products[:, POSE_COLUMNS, POSE_COLUMNS]
    equations.border[at_pose] += products[:, POSE_COLUMNS, CONSTANTS_COLUMNS]
    equations.slope[at_pose] += products[:, POSE_COLUMNS, RESIDUAL_COLUMN]
    common = rows[:, :, COMMON_COLUMNS].reshape(-1, N_CONSTANTS + 1)
    corner = common.T @ common
    equations.corner += corner[:N_CONSTANTS, :N_CONSTANTS]
    equations.corner_slope += corner[:N_CONSTANTS, N_CONSTANTS]
    if rows.shape[2] == NEXT_POSE_COLUMNS.stop:
        equations.diagonal[at_next_pose] += products[:, NEXT_POSE_COLUMNS, NEXT_POSE_COLUMNS]
        equations.upper[at_pose] += products[:, POSE_COLUMNS, NEXT_POSE_COLUMNS]
        equations.border[at_next_pose] += products[:, NEXT_POSE_COLUMNS, CONSTANTS_COLUMNS]
        equations.slope[at_next_pose] += products[:, NEXT_POSE_COLUMNS, RESIDUAL_COLUMN]


def _pose_slices(pose_index: NDArray[np.intp]) -> tuple[NDArray[np.intp] | slice, NDArray[np.intp] | slice]:
    """Return indices of the factors' poses and of the poses after them.

    They are slices, which numpy adds to faster, where every pose of a range has a factor.
    """
    if len(pose_index) and pose_index[-1] - pose_index[0] == len(pose_index) - 1:
        first, end = int(pose_index[0]), int(pose_index[0]) + len(pose_index)
        return slice(first, end), slice(first + 1, end + 1)
    return pose_index, pose_index + 1


def _solve_step(
    linearised: list[tuple[LinearisedFactors, Loss]], n: int, damping: float
) -> tuple[Array, Array]:
    """Return the damped Gauss-Newton step of poses and constants."""
    equations = _assemble_equations(linearised, n)
    if damping > 0.0:
        added_damping = damping * np.einsum("kii->ki", equations.diagonal)
        np.einsum("kii->ki", equations.diagonal)[...] += added_damping
        equations.corner[np.diag_indices(N_CONSTANTS)] *= 1.0 + damping
    right = np.concatenate([-equations.slope[:, :, None], -equations.border], axis=2)
    try:
        x = solve_chain(equations.diagonal, equations.upper, right).x
        free_step, by_constants = x[:, :, 0], x[:, :, 1:]
        corner = equations.corner + np.tensordot(equations.border, by_constants, ((0, 1), (0, 1)))
        slope = -equations.corner_slope - np.tensordot(equations.border, free_step, ((0, 1), (0, 1)))
        constants_step = np.linalg.solve(corner, slope)
    except np.linalg.LinAlgError:
        raise InputError(
            "odometry, fixes and headings do not determine a track; check their sigmas"
        ) from None
    return free_step + by_constants @ constants_step, np.asarray(constants_step)


def _compute_covariances(
    linearised: list[tuple[LinearisedFactors, Loss]], n: int, of_poses: bool
) -> tuple[Array, Array, Array]:
    """Return covariances of poses, of poses with pose 0, and of constants, from the bordered inverse."""
    equations = _assemble_equations(linearised, n)
    if not of_poses:
        by_constants = solve_chain(equations.diagonal, equations.upper, -equations.border).x
        corner = equations.corner + np.tensordot(equations.border, by_constants, ((0, 1), (0, 1)))
        no_covariance = np.zeros((0, 3, 3))
        return no_covariance, no_covariance, np.asarray(np.linalg.inv(corner))
    unit_columns = np.zeros((n, 3, 3))
    unit_columns[0] = np.eye(3)
    chain = solve_chain(
        equations.diagonal,
        equations.upper,
        np.concatenate([-equations.border, unit_columns], axis=2),
        covariance=True,
    )
    by_constants, from_start = chain.x[:, :, :N_CONSTANTS], chain.x[:, :, N_CONSTANTS:]
    constants = np.linalg.inv(
        equations.corner + np.tensordot(equations.border, by_constants, ((0, 1), (0, 1)))
    )
    by_constants_covariance = by_constants @ constants
    return (
        chain.covariance + by_constants_covariance @ by_constants.transpose(0, 2, 1),
        from_start + by_constants_covariance @ by_constants[0].T,
        np.asarray(constants),
    )
