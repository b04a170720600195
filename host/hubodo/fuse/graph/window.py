"""A window over the newest poses of a growing graph; older poses are marginalised into a Gaussian prior."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factor_graph import FactorGraph
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.prior import MarginalPriorFactors
from hubodo.fuse.graph.solver import (
    CONSTANTS_COLUMNS,
    NEXT_POSE_COLUMNS,
    POSE_COLUMNS,
    RESIDUAL_COLUMN,
    solve_graph,
    weighted_rows,
)

_REMAINING_ROWS = slice(3, 6 + N_CONSTANTS)
"""Rows of the triangle without those of its first pose: of the next pose and the constants."""


@dataclass(frozen=True, eq=False)
class PoseWindow:
    """A graph of n poses and its solution.

    Attributes
    ----------
    graph : the factors.
    pose_t : (n,) s.
    poses : (n, 3).
    constants : (N_CONSTANTS,).
    covariance : (3, 3) of the newest pose.
    constants_covariance : (N_CONSTANTS, N_CONSTANTS).
    """

    graph: FactorGraph
    pose_t: Array
    poses: Array
    constants: Array
    covariance: Array
    constants_covariance: Array

    def with_pose(self, later: FactorGraph, t: float, pose: Array) -> PoseWindow:
        """Return the window with a further pose, initial guess (3,), tied to its newest by `later`."""
        graph = self.graph.append(later, len(self.poses) - 1)
        poses = np.concatenate([self.poses, pose[None]])
        return replace(self, graph=graph, pose_t=np.append(self.pose_t, t), poses=poses)

    def with_solution(self) -> PoseWindow:
        """Return the window with optimal poses and constants, every factor linearised again.

        Raises InputError as `solve_graph`.
        """
        solution = solve_graph(self.graph, self.poses, self.constants, "all")
        return replace(
            self,
            poses=solution.poses,
            constants=solution.constants,
            covariance=solution.covariance[-1],
            constants_covariance=solution.constants_covariance,
        )

    def without_poses_before(self, t: float) -> PoseWindow:
        """Return the window without poses before t, at least two left; the others are marginalised."""
        count = min(int(np.searchsorted(self.pose_t, t)), len(self.poses) - 2)
        if count <= 0:
            return self
        return replace(
            self,
            graph=marginalise_first_poses(self.graph, self.poses, self.constants, count),
            pose_t=self.pose_t[count:],
            poses=self.poses[count:],
        )


def marginalise_first_poses(graph: FactorGraph, poses: Array, constants: Array, count: int) -> FactorGraph:
    """Return the graph of poses `count` on, with a prior in place of earlier factors.

    The prior is of pose `count` and the constants. The earlier factors are linearised at the present estimate
    and their weights are frozen. Their rows, ordered by pose, next pose and constants, are brought to
    triangular form (Householder QR): the rows below those of the marginalised pose do not depend on it and
    hold all information on the rest (Dellaert and Kaess 2006, section 3).
    """
    marginalised = graph.select_poses(0, count)
    rows_by_pose: list[list[Array]] = [[] for _ in range(count)]
    for item, loss in marginalised.linearise(poses[: count + 1], constants):
        for state, rows in weighted_rows(item, loss):
            for k, row in zip(state.tolist(), rows, strict=True):
                rows_by_pose[k].append(row)
    prior = np.zeros((0, NEXT_POSE_COLUMNS.start))
    for blocks in rows_by_pose:
        stacked = np.concatenate([_order_columns(row) for row in (prior, *blocks)])
        triangle = np.linalg.qr(stacked, mode="r")[_REMAINING_ROWS]
        prior = np.concatenate([triangle[:, POSE_COLUMNS.stop : -1], triangle[:, -1:]], axis=1)
    linearisation_point = np.concatenate([poses[count], constants])
    prior_factors = MarginalPriorFactors(
        np.zeros(1, np.intp),
        sqrt_information=prior[None, :, :RESIDUAL_COLUMN],
        offset=prior[None, :, RESIDUAL_COLUMN],
        linearisation_point=linearisation_point[None],
    )
    return FactorGraph((*graph.select_poses(count, len(poses)).factors, prior_factors))


def _order_columns(rows: Array) -> Array:
    """Return rows with columns ordered by pose, next pose, constants, residual."""
    next_pose = (
        rows[:, NEXT_POSE_COLUMNS] if rows.shape[1] == NEXT_POSE_COLUMNS.stop else np.zeros((len(rows), 3))
    )
    return np.concatenate(
        [rows[:, POSE_COLUMNS], next_pose, rows[:, CONSTANTS_COLUMNS], rows[:, RESIDUAL_COLUMN, None]], axis=1
    )
