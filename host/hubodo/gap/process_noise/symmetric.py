"""A stack of symmetric matrices, one per block of a log, stored as triangles to save memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array

# Matrices unpacked at a time.
_CHUNK_MATRICES = 64


@dataclass(frozen=True)
class SymmetricStack:
    """A stack of B symmetric matrices.

    size: S, rows of each matrix
    triangles: (B, S (S + 1) / 2), rows of the upper triangles
    """

    size: int
    triangles: Array

    @staticmethod
    def allocate(count: int, size: int) -> SymmetricStack:
        """Return an uninitialised stack."""
        return SymmetricStack(size, np.empty((count, size * (size + 1) // 2)))

    def __len__(self) -> int:
        return len(self.triangles)

    def store(self, first: int, matrices: Array) -> None:
        """Store matrices, (b, S, S), from index `first` on."""
        rows, columns = np.triu_indices(self.size)
        self.triangles[first : first + len(matrices)] = matrices[:, rows, columns]

    def unpack(self) -> Array:
        """Return all matrices, (B, S, S)."""
        return self._unpack_triangles(self.triangles)

    def sum(self) -> Array:
        """Return the sum of all matrices, (S, S)."""
        return np.asarray(self._unpack_triangles(self.triangles.sum(axis=0)))

    def multiply(self, vector: Array) -> Array:
        """Return each matrix times a vector, (B, S)."""
        return np.concatenate([matrices @ vector for matrices in self._unpack_chunks()])

    def select(self, indices: Sequence[int]) -> SymmetricStack:
        """Return the stack of some rows and columns, in their order."""
        rows, columns = np.triu_indices(len(indices))
        chosen = self._triangle_indices()[np.ix_(indices, indices)]
        return SymmetricStack(len(indices), self.triangles.take(chosen[rows, columns], axis=1))

    def _unpack_chunks(self) -> Iterator[Array]:
        for first in range(0, len(self), _CHUNK_MATRICES):
            yield self._unpack_triangles(self.triangles[first : first + _CHUNK_MATRICES])

    def _unpack_triangles(self, triangles: Array) -> Array:
        return triangles.take(self._triangle_indices(), axis=-1)

    def _triangle_indices(self) -> NDArray[np.intp]:
        """Return the position of each element in a triangle, (S, S)."""
        rows, columns = np.triu_indices(self.size)
        indices = np.empty((self.size, self.size), np.intp)
        indices[rows, columns] = indices[columns, rows] = np.arange(len(rows))
        return indices
