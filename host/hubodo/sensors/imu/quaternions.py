"""Rotations of many turns at once as unit quaternions, scalar first, and their products along each turn."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array


def cross(a: Array, b: Array) -> Array:
    """np.cross for arrays (..., 3), several times as fast."""
    ax, ay, az, bx, by, bz = (v[..., i] for v in (a, b) for i in range(3))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def quaternions(angle: Array) -> Array:
    """(4, ...) unit quaternions, scalar first, of rotation vectors (..., 3)."""
    x, y, z = np.moveaxis(angle, -1, 0)
    size = np.sqrt(x * x + y * y + z * z)
    share = np.sinc(size / (2 * np.pi)) / 2
    return np.stack([np.cos(size / 2), share * x, share * y, share * z])


def product(q: Array) -> Array:
    """(4, T) ordered product of (4, T, L), pair by pair, so that the depth is log2 L."""
    while q.shape[2] > 1:
        q = _pairs(q)
    return q[..., 0]


def products_after(q: Array) -> tuple[Array, Array]:
    """The ordered product of (4, T, L), (4, T), and for each the product of those after it, (4, T, L)."""
    if q.shape[2] == 1:
        one = np.zeros_like(q)
        one[0] = 1
        return q[..., 0], one
    whole, beyond = products_after(_pairs(q))
    count = q.shape[2]
    after = np.empty_like(q)
    after[..., 1::2] = beyond[..., : count // 2]
    even = after[..., ::2]
    even[..., : count // 2] = _times(q[..., 1::2], beyond[..., : count // 2])
    if count % 2:
        even[..., -1] = beyond[..., -1]
    return whole, after


def _pairs(q: Array) -> Array:
    """(4, T, L/2) products of neighbours in (4, T, L); the last of an odd count as it is."""
    made = _times(q[..., : q.shape[2] // 2 * 2 : 2], q[..., 1::2])
    return np.concatenate([made, q[..., -1:]], axis=2) if q.shape[2] % 2 else made


def _times(a: Array, b: Array) -> Array:
    """Quaternions (4, ...) one times the other."""
    (w, x, y, z), (v, i, j, k) = a, b
    return np.stack(
        [
            w * v - (x * i + y * j + z * k),
            w * i + v * x + (y * k - z * j),
            w * j + v * y + (z * i - x * k),
            w * k + v * z + (x * j - y * i),
        ]
    )


def matrices_back(q: Array) -> Array:
    """(..., 3, 3) R' with R the rotations of (4, ...)."""
    w, x, y, z = q
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
        [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def rotate_back(q: Array, vector: Array) -> Array:
    """R' v with R the rotation of q: the components of a fixed vector after the node turned by R."""
    u = -q[:, 1:]
    twice = 2 * cross(u, vector)
    return np.asarray(vector + q[:, :1] * twice + cross(u, twice))
