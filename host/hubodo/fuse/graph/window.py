"""A window over the newest poses of a growing graph: what it lets go stays as a Gaussian prior."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.graph.factor_graph import Graph
from hubodo.fuse.graph.factors.constants import COUNT
from hubodo.fuse.graph.factors.prior import ForgottenFactor
from hubodo.fuse.graph.solver import CONSTANTS, NEXT, POSE, RESIDUAL, solve, weighted_rows

_KEPT = slice(3, 6 + COUNT)
"""Rows of a triangle that are left when its first pose is gone: the next pose and the constants."""


@dataclass(frozen=True, eq=False)
class PoseWindow:
    """A graph of n poses at state_t, s, and its solution.

    poses (n, 3), constants (COUNT,); covariance (3, 3) of the newest pose, constants_covariance (COUNT,
    COUNT).
    """

    graph: Graph
    state_t: Array
    poses: Array
    constants: Array
    covariance: Array
    constants_covariance: Array

    def extended(self, later: Graph, t: float, pose: Array) -> PoseWindow:
        """With one pose more, at a first guess (3,). later: what ties it; its pose 0 is the newest here."""
        graph = self.graph.joined(later, len(self.poses) - 1)
        poses = np.concatenate([self.poses, pose[None]])
        return replace(self, graph=graph, state_t=np.append(self.state_t, t), poses=poses)

    def solved(self) -> PoseWindow:
        """With all its poses and the constants where they fit best, every factor linearised anew.

        Raises InputError as `solve`.
        """
        found = solve(self.graph, self.poses, self.constants, "all")
        return replace(
            self,
            poses=found.poses,
            constants=found.constants,
            covariance=found.covariance[-1],
            constants_covariance=found.constants_covariance,
        )

    def since(self, t: float) -> PoseWindow:
        """Without the poses before t, two or more left; what their factors said of the rest is kept."""
        count = min(int(np.searchsorted(self.state_t, t)), len(self.poses) - 2)
        if count <= 0:
            return self
        return replace(
            self,
            graph=without_first(self.graph, self.poses, self.constants, count),
            state_t=self.state_t[count:],
            poses=self.poses[count:],
        )


def without_first(graph: Graph, poses: Array, constants: Array, count: int) -> Graph:
    """The graph of poses `count` on, with a prior in place of all factors before.

    The prior is of the first pose that stays and of the constants.

    Those factors are linearised where they are now and weigh what their losses give them now, for good. Their
    rows, side by side by pose, next pose and constants, are turned into a triangle (Householder): the rows
    below those of the pose that goes are free of it and hold all that was said of the others (Dellaert and
    Kaess 2006, section 3).
    """
    gone = graph.part(0, count)
    waiting: list[list[Array]] = [[] for _ in range(count)]
    for item, loss in gone.linear(poses[: count + 1], constants):
        for state, rows in weighted_rows(item, loss):
            for k, row in zip(state.tolist(), rows, strict=True):
                waiting[k].append(row)
    prior = np.zeros((0, NEXT.start))
    for blocks in waiting:
        stacked = np.concatenate([_in_order(row) for row in (prior, *blocks)])
        triangle = np.linalg.qr(stacked, mode="r")[_KEPT]
        prior = np.concatenate([triangle[:, POSE.stop : -1], triangle[:, -1:]], axis=1)
    about = np.concatenate([poses[count], constants])
    forgotten = ForgottenFactor(
        np.zeros(1, np.intp),
        root=prior[None, :, :RESIDUAL],
        offset=prior[None, :, RESIDUAL],
        about=about[None],
    )
    return Graph((*graph.part(count, len(poses)).factors, forgotten))


def _in_order(rows: Array) -> Array:
    """Rows by pose, next pose, constants, residual."""
    after = rows[:, NEXT] if rows.shape[1] == NEXT.stop else np.zeros((len(rows), 3))
    return np.concatenate([rows[:, POSE], after, rows[:, CONSTANTS], rows[:, RESIDUAL, None]], axis=1)
