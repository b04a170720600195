"""The model linearised about one point: all that the data say about moving away from it, in matrices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.linear.sensitivity import Direction, Directions
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.point import Point
from hubodo.gap.process_noise.symmetric import Symmetric
from hubodo.gap.state.state import State

# Of what a column said before anything was taken out: less than this is rounding.
_ROUNDING = 1e-5


@dataclass(frozen=True)
class Linearised:
    """A model about a point, as grams of its directions.

    directions: as asked; after them come nuisances, always free. blocks: of D+1 each, a gram for each
    stretch of time, the last row the residual's. raw: (D+1,) see `Innovations`. logs: their logarithms.
    """

    directions: tuple[Direction, ...]
    nuisances: int
    blocks: Symmetric
    raw: Array
    logs: float

    @property
    def gram(self) -> Array:
        return self.blocks.total()

    @property
    def always(self) -> list[int]:
        """Indices of what is always free."""
        return list(range(len(self.directions), len(self.directions) + self.nuisances))

    def along(self, directions: Sequence[Direction]) -> Linearised:
        """The same of some of its directions alone. Raises KeyError for one that is not among them."""
        places = {direction: k for k, direction in enumerate(self.directions)}
        kept = [*(places[direction] for direction in directions), *self.always, len(self.raw) - 1]
        return Linearised(tuple(directions), self.nuisances, self.blocks.of(kept), self.raw[kept], self.logs)


def linearise(point: Point, directions: Sequence[Direction]) -> Linearised:
    """All that the data say about the directions, from this point.

    Nuisances are the attitudes of nodes on the body.
    """
    nuisances = 3 * sum(not node.on_wheel for node in point.problem.nodes)
    columns = _Columns(point.state, directions)
    found = point.innovations(columns, len(directions) + nuisances)
    return Linearised(tuple(directions), nuisances, found.grams, found.raw, found.logs)


class _Columns:
    """Those of the directions; the attitude of a node on the body comes after its own."""

    def __init__(self, state: State, directions: Sequence[Direction]) -> None:
        self._directions = Directions(state, directions)
        bodies = [node for node in state.problem.nodes if not node.on_wheel]
        places = {node.name: len(directions) + 3 * k for k, node in enumerate(bodies)}
        self.at = {
            name: [*felt, *(range(places[name], places[name] + 3) if name in places else ())]
            for name, felt in self._directions.at.items()
        }
        self._turns = {
            node.name: state.attitude_columns(node) for node in bodies if not state.at_once(node.name)
        }

    def of(self, node: NodeData, state: State, samples: Mapping[str, slice]) -> NDArray[np.float32]:
        """(P, 6, N), see `NodeColumns`."""
        made = self._directions.of(node, state, samples)
        if node.on_wheel:
            return made
        whole = self._turns.get(node.name)
        turns = state.attitude_columns(node) if whole is None else whole[:, :, samples[node.name]]
        return np.concatenate([made, turns.astype(np.float32)])


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
