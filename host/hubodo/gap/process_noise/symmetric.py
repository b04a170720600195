"""Symmetric matrices, one for each block of a log, kept by their halves: a long log has many."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

# Matrices that are looked at whole at a time.
_AT_ONCE = 64


@dataclass(frozen=True)
class Symmetric:
    """size: S, of each matrix. halves: (B, S (S + 1) / 2), the rows of their upper triangles."""

    size: int
    halves: Array

    @staticmethod
    def room(count: int, size: int) -> Symmetric:
        """For so many matrices, none of them known."""
        return Symmetric(size, np.empty((count, size * (size + 1) // 2)))

    def __len__(self) -> int:
        return len(self.halves)

    def put(self, first: int, whole: Array) -> None:
        """From the first on, matrices that are known: (b, S, S)."""
        rows, columns = np.triu_indices(self.size)
        self.halves[first : first + len(whole)] = whole[:, rows, columns]

    def whole(self) -> Array:
        """(B, S, S)."""
        return self._unfolded(self.halves)

    def total(self) -> Array:
        """(S, S): the sum of all."""
        return np.asarray(self._unfolded(self.halves.sum(axis=0)))

    def times(self, vector: Array) -> Array:
        """(B, S): each times a vector."""
        return np.concatenate([whole @ vector for whole in self._in_turn()])

    def of(self, kept: Sequence[int]) -> Symmetric:
        """Of some rows and columns, in their order."""
        rows, columns = np.triu_indices(len(kept))
        chosen = self._places()[np.ix_(kept, kept)]
        return Symmetric(len(kept), self.halves.take(chosen[rows, columns], axis=1))

    def _in_turn(self) -> Iterator[Array]:
        for first in range(0, len(self), _AT_ONCE):
            yield self._unfolded(self.halves[first : first + _AT_ONCE])

    def _unfolded(self, halves: Array) -> Array:
        return halves.take(self._places(), axis=-1)

    def _places(self) -> NDArray[np.intp]:
        """(S, S): where in a half each element stands."""
        rows, columns = np.triu_indices(self.size)
        made = np.empty((self.size, self.size), np.intp)
        made[rows, columns] = made[columns, rows] = np.arange(len(rows))
        return made
