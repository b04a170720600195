"""The model linearised about one evaluation: gram matrices of all directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.linear.sensitivity import Direction, DirectionSensitivities
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.symmetric import SymmetricStack
from hubodo.gap.state.state import State

# Information below this share of a column's raw squares is rounding error.
_MIN_INFORMATION_SHARE = 1e-5


@dataclass(frozen=True)
class Linearisation:
    """A linearised model as gram matrices of its directions.

    directions: the requested directions; in the matrices nuisances follow them, which are always free
    block_grams: (D+1, D+1) for each block of time; the last row belongs to the residual
    raw_squares, channel_squares: as in `Innovations`
    log_determinant: ln det of the innovation covariance
    """

    directions: tuple[Direction, ...]
    n_nuisances: int
    block_grams: SymmetricStack
    raw_squares: Array
    channel_squares: Array
    log_determinant: float

    @property
    def gram(self) -> Array:
        return self.block_grams.sum()

    @property
    def nuisance_indices(self) -> list[int]:
        """Return the indices of the nuisances."""
        return list(range(len(self.directions), len(self.directions) + self.n_nuisances))

    def select_directions(self, directions: Sequence[Direction]) -> Linearisation:
        """Return the linearisation along some of its directions. Raises KeyError for an unknown one."""
        indices = {direction: k for k, direction in enumerate(self.directions)}
        selected = [
            *(indices[direction] for direction in directions),
            *self.nuisance_indices,
            len(self.raw_squares) - 1,
        ]
        return Linearisation(
            tuple(directions),
            self.n_nuisances,
            self.block_grams.select(selected),
            self.raw_squares[selected],
            self.channel_squares[selected[:-1]],
            self.log_determinant,
        )


def linearise(evaluation: Evaluation, directions: Sequence[Direction]) -> Linearisation:
    """Linearise the model along directions; attitudes of nodes on the body are nuisances."""
    nuisances = 3 * sum(not node.on_wheel for node in evaluation.problem.nodes)
    columns = _DirectionColumns(evaluation.state, directions)
    innovations = evaluation.compute_innovations(columns, len(directions) + nuisances)
    return Linearisation(
        tuple(directions),
        nuisances,
        innovations.grams,
        innovations.raw_squares,
        innovations.channel_squares,
        innovations.log_determinant,
    )


class _DirectionColumns:
    """Sensitivity columns of the directions, followed by those of the attitude for a node on the body."""

    def __init__(self, state: State, directions: Sequence[Direction]) -> None:
        self._directions = DirectionSensitivities(state, directions)
        bodies = [node for node in state.problem.nodes if not node.on_wheel]
        first_indices = {node.name: len(directions) + 3 * k for k, node in enumerate(bodies)}
        self.indices = {
            name: [
                *own,
                *(range(first_indices[name], first_indices[name] + 3) if name in first_indices else ()),
            ]
            for name, own in self._directions.indices.items()
        }
        self._turns = {
            node.name: state.attitude_columns(node) for node in bodies if not state.is_memoryless(node.name)
        }

    def columns(self, node: NodeData, state: State, samples: Mapping[str, slice]) -> NDArray[np.float32]:
        """Return the columns of a node, (P, 6, N); see `NodeColumns`."""
        columns = self._directions.columns(node, state, samples)
        if node.on_wheel:
            return columns
        all_turns = self._turns.get(node.name)
        turns = state.attitude_columns(node) if all_turns is None else all_turns[:, :, samples[node.name]]
        return np.concatenate([columns, turns.astype(np.float32)])


def invert_information(
    information: Array, raw_squares: Array, prior_information: Array | float = 0.0
) -> Array:
    """Return the inverse of an information matrix, (k, k); zero for unobservable coordinates.

    The information left after eliminating walks and other columns may be rounding error only. A Cholesky
    factorisation with pivoting takes the most informative coordinates first; those without remaining
    information are frozen.

    prior_information: (k,) added to the diagonal of the observable part
    """
    remaining, observed = information.copy(), list[int]()
    rounding = _MIN_INFORMATION_SHARE * np.maximum(raw_squares, 1e-12)
    for _ in range(len(raw_squares)):
        pivots = remaining.diagonal() * (remaining.diagonal() > rounding)
        pivots[observed] = 0.0
        pivot = int(np.argmax(pivots))
        if pivots[pivot] <= 0.0:
            break
        observed.append(pivot)
        remaining -= remaining[pivot][:, None] * remaining[pivot] / remaining[pivot, pivot]
    covariance = np.zeros_like(information)
    prior = np.diag(np.broadcast_to(prior_information, len(information))[observed])
    covariance[np.ix_(observed, observed)] = np.linalg.inv(information[np.ix_(observed, observed)] + prior)
    return covariance
