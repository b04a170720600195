"""A window over the newest poses of a growing graph: what it lets go stays as a Gaussian prior."""

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
"""Rows of a triangle that are left when its first pose is gone: the next pose and the constants."""


@dataclass(frozen=True, eq=False)
class PoseWindow:
    """A graph of n poses at pose_t, s, and its solution.

    poses (n, 3), constants (COUNT,); covariance (3, 3) of the newest pose, constants_covariance (COUNT,
    COUNT).
    """

    graph: FactorGraph
    pose_t: Array
    poses: Array
    constants: Array
    covariance: Array
    constants_covariance: Array

    def with_pose(self, later: FactorGraph, t: float, pose: Array) -> PoseWindow:
        """With one pose more, at a first guess (3,). later: what ties it; its pose 0 is the newest here."""
        graph = self.graph.append(later, len(self.poses) - 1)
        poses = np.concatenate([self.poses, pose[None]])
        return replace(self, graph=graph, pose_t=np.append(self.pose_t, t), poses=poses)

    def with_solution(self) -> PoseWindow:
        """With all its poses and the constants where they fit best, every factor linearised anew.

        Raises InputError as `solve`.
        """
        found = solve_graph(self.graph, self.poses, self.constants, "all")
        return replace(
            self,
            poses=found.poses,
            constants=found.constants,
            covariance=found.covariance[-1],
            constants_covariance=found.constants_covariance,
        )

    def without_poses_before(self, t: float) -> PoseWindow:
        """Without the poses before t, two or more left; what their factors said of the rest is kept."""
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
    """The graph of poses `count` on, with a prior in place of all factors before.

    The prior is of the first pose that stays and of the constants.

    Those factors are linearised where they are now and weigh what their losses give them now, for good. Their
    rows, side by side by pose, next pose and constants, are turned into a triangle (Householder): the rows
    below those of the pose that goes are free of it and hold all that was said of the others (Dellaert and
    Kaess 2006, section 3).
    """
    gone = graph.select_poses(0, count)
    waiting: list[list[Array]] = [[] for _ in range(count)]
    for item, loss in gone.linearise(poses[: count + 1], constants):
        for state, rows in weighted_rows(item, loss):
            for k, row in zip(state.tolist(), rows, strict=True):
                waiting[k].append(row)
    prior = np.zeros((0, NEXT_POSE_COLUMNS.start))
    for blocks in waiting:
        stacked = np.concatenate([_order_columns(row) for row in (prior, *blocks)])
        triangle = np.linalg.qr(stacked, mode="r")[_REMAINING_ROWS]
        prior = np.concatenate([triangle[:, POSE_COLUMNS.stop : -1], triangle[:, -1:]], axis=1)
    about = np.concatenate([poses[count], constants])
    forgotten = MarginalPriorFactors(
        np.zeros(1, np.intp),
        sqrt_information=prior[None, :, :RESIDUAL_COLUMN],
        offset=prior[None, :, RESIDUAL_COLUMN],
        linearisation_point=about[None],
    )
    return FactorGraph((*graph.select_poses(count, len(poses)).factors, forgotten))


def _order_columns(rows: Array) -> Array:
    """Rows by pose, next pose, constants, residual."""
    after = (
        rows[:, NEXT_POSE_COLUMNS] if rows.shape[1] == NEXT_POSE_COLUMNS.stop else np.zeros((len(rows), 3))
    )
    return np.concatenate(
        [rows[:, POSE_COLUMNS], after, rows[:, CONSTANTS_COLUMNS], rows[:, RESIDUAL_COLUMN, None]], axis=1
    )
