"""The model linearised about one point: all that the data say about moving away from it, in matrices."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.linear.sensitivity import Direction, columns
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.point import NodeColumns, Point
from hubodo.gap.state.state import State

# Of what a column said before anything was taken out: less than this is rounding.
_ROUNDING = 1e-5


@dataclass(frozen=True)
class Linearised:
    """A model about a point, as grams of its directions.

    directions: as asked; after them come nuisances, always free. blocks: (B, D+1, D+1), a gram for each
    stretch of time, the last row the residual's. raw: (D+1,) see `Innovations`. logs: their logarithms.
    """

    directions: tuple[Direction, ...]
    nuisances: int
    blocks: Array
    raw: Array
    logs: float

    @property
    def gram(self) -> Array:
        return np.asarray(self.blocks.sum(axis=0))

    @property
    def always(self) -> list[int]:
        """Indices of what is always free."""
        return list(range(len(self.directions), len(self.directions) + self.nuisances))


def linearise(point: Point, directions: Sequence[Direction]) -> Linearised:
    """All that the data say about the directions, from this point.

    Nuisances are the attitudes of nodes on the body.
    """
    nuisances = 3 * sum(not node.on_wheel for node in point.problem.nodes)
    found = point.innovations(_columns(point.state, directions), len(directions) + nuisances)
    return Linearised(tuple(directions), nuisances, found.grams, found.raw, found.logs)


def _columns(state: State, directions: Sequence[Direction]) -> Iterator[tuple[NodeData, NodeColumns]]:
    """Those of each node, the attitude of one on the body after its directions."""
    bodies = [node for node in state.problem.nodes if not node.on_wheel]
    for node, felt, made in columns(state, directions):
        at = felt
        if not node.on_wheel:
            made = np.concatenate([made, state.attitude_columns(node).astype(np.float32)])
            first = len(directions) + 3 * bodies.index(node)
            at = [*felt, *range(first, first + 3)]
        own = NodeColumns(made, at)
        del made
        yield node, own
        # Those of the next node are made when nobody has these any more.
        del own


def solved(inner: Array, raw: Array) -> Array:
    """The inverse of information, (k, k), where there is any; zero for coordinates that are frozen.

    What is left of a column, raw: (k,), once walks and other columns are taken out may be rounding alone. The
    coordinates that say most go first (Cholesky with pivots), and what the others then do not see is frozen.
    """
    left, seen = inner.copy(), list[int]()
    rounding = _ROUNDING * np.maximum(raw, 1e-12)
    for _ in range(len(raw)):
        worth = left.diagonal() * (left.diagonal() > rounding)
        worth[seen] = 0.0
        first = int(np.argmax(worth))
        if worth[first] <= 0.0:
            break
        seen.append(first)
        left -= left[first][:, None] * left[first] / left[first, first]
    covariance = np.zeros_like(inner)
    covariance[np.ix_(seen, seen)] = np.linalg.inv(inner[np.ix_(seen, seen)])
    return covariance
