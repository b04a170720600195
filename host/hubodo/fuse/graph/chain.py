"""Block cyclic reduction for chains of states bordered by a few common constants.

The normal equations of a drive are block tridiagonal, bordered by the constants. All blocks of one level of
the reduction are processed at once, so an hour at 5 Hz takes tens of milliseconds, with every pose's
covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array

_MAX_DENSE_BLOCKS = 4
"""Blocks; so few are inverted as one matrix, which is as fast as one more level."""


class ChainSolution(NamedTuple):
    """Solution of a chain of equations.

    Attributes
    ----------
    x : (n, b, m).
    covariance : (n, b, b), diagonal blocks of the inverse; empty unless asked for.
    next_covariance : (n - 1, b, b), blocks to the right of them; empty unless asked for.
    """

    x: Array
    covariance: Array
    next_covariance: Array


def solve_chain(diagonal: Array, upper: Array, right: Array, covariance: bool = False) -> ChainSolution:
    """Solve H x = right for a symmetric positive definite block tridiagonal H of b x b blocks.

    diagonal: (n, b, b); upper: (n - 1, b, b), H[k, k + 1]; right: (n, b, m). Every second state is
    eliminated, which leaves a chain of half the length (Buzbee, Golub and Nielson 1970). The covariances
    follow on the way back, from x_odd = -inv(D) (L' x_left + U x_right) + noise of covariance inv(D), with D
    the eliminated diagonal blocks, L and U their couplings to the left and right. Raises
    numpy.linalg.LinAlgError when H is singular.
    """
    n = len(diagonal)
    if n <= _MAX_DENSE_BLOCKS:
        return _solve_dense(diagonal, upper, right)
    odd = diagonal[1::2]
    left, to_next = upper[0::2], upper[1::2]
    count, inner = len(odd), len(to_next)
    inverse = np.linalg.inv(odd)
    from_left = left @ inverse
    from_right = to_next.transpose(0, 2, 1) @ inverse[:inner]
    even = diagonal[0::2].copy()
    even[:count] -= from_left @ left.transpose(0, 2, 1)
    even[1 : inner + 1] -= from_right @ to_next
    even_right = right[0::2].copy()
    even_right[:count] -= from_left @ right[1::2]
    even_right[1 : inner + 1] -= from_right @ right[1::2][:inner]
    half_chain = solve_chain(even, -(from_left[:inner] @ to_next), even_right, covariance)

    x = np.empty_like(right)
    x[0::2] = half_chain.x
    x_odd = inverse @ right[1::2] - from_left.transpose(0, 2, 1) @ half_chain.x[:count]
    x_odd[:inner] -= from_right.transpose(0, 2, 1) @ half_chain.x[1 : inner + 1]
    x[1::2] = x_odd
    if not covariance:
        return ChainSolution(x, diagonal[:0], upper[:0])
    p, cross = half_chain.covariance, half_chain.next_covariance
    to_left = -p[:count] @ from_left
    to_left[:inner] -= cross[:inner] @ from_right
    to_right = -from_left[:inner].transpose(0, 2, 1) @ cross[:inner]
    to_right -= from_right.transpose(0, 2, 1) @ p[1 : inner + 1]
    odd_covariance = inverse - from_left.transpose(0, 2, 1) @ to_left
    odd_covariance[:inner] -= (to_right @ from_right).transpose(0, 2, 1)
    blocks, between = np.empty_like(diagonal), np.empty_like(upper)
    blocks[0::2], blocks[1::2] = p, odd_covariance
    between[0::2], between[1::2] = to_left, to_right
    return ChainSolution(x, blocks, between)


def _solve_dense(diagonal: Array, upper: Array, right: Array) -> ChainSolution:
    """Solve a short chain as one dense matrix."""
    n, b, m = right.shape
    matrix = np.zeros((n, b, n, b))
    for k in range(n):
        matrix[k, :, k] = diagonal[k]
        if k + 1 < n:
            matrix[k, :, k + 1] = upper[k]
            matrix[k + 1, :, k] = upper[k].T
    inverse = np.linalg.inv(matrix.reshape(n * b, n * b))
    blocks = inverse.reshape(n, b, n, b)
    return ChainSolution(
        (inverse @ right.reshape(n * b, m)).reshape(n, b, m),
        np.array([blocks[k, :, k] for k in range(n)]),
        np.array([blocks[k, :, k + 1] for k in range(n - 1)]).reshape(n - 1, b, b),
    )
