"""Vectorised unit quaternions (scalar first) of many turns, and their ordered products along each turn."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of arrays (..., 3), several times faster than np.cross."""
    ax, ay, az, bx, by, bz = (v[..., i] for v in (a, b) for i in range(3))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def quaternions_from_vectors(angle: Array) -> Array:
    """Return the (4, ...) unit quaternions, scalar first, of rotation vectors (..., 3)."""
    x, y, z = np.moveaxis(angle, -1, 0)
    size = np.sqrt(x * x + y * y + z * z)
    half_sinc = np.sinc(size / (2 * np.pi)) / 2
    return np.stack([np.cos(size / 2), half_sinc * x, half_sinc * y, half_sinc * z])


def chain_product(q: Array) -> Array:
    """Return the (4, T) ordered product of quaternions (4, T, L), by pairwise reduction in log2 L steps."""
    while q.shape[2] > 1:
        q = _pairs(q)
    return q[..., 0]


def chain_products_after(q: Array) -> tuple[Array, Array]:
    """Return the ordered product of (4, T, L), and for each factor the product of all later ones."""
    if q.shape[2] == 1:
        one = np.zeros_like(q)
        one[0] = 1
        return q[..., 0], one
    total, later_products = chain_products_after(_pairs(q))
    count = q.shape[2]
    after = np.empty_like(q)
    after[..., 1::2] = later_products[..., : count // 2]
    even = after[..., ::2]
    even[..., : count // 2] = _times(q[..., 1::2], later_products[..., : count // 2])
    if count % 2:
        even[..., -1] = later_products[..., -1]
    return total, after


def _pairs(q: Array) -> Array:
    """Return the (4, T, L/2) products of neighbours in (4, T, L); an odd last factor is kept unchanged."""
    products = _times(q[..., : q.shape[2] // 2 * 2 : 2], q[..., 1::2])
    return np.concatenate([products, q[..., -1:]], axis=2) if q.shape[2] % 2 else products


def _times(a: Array, b: Array) -> Array:
    """Return the product a b of quaternions, (4, ...)."""
    (w, x, y, z), (v, i, j, k) = a, b
    return np.stack(
        [
            w * v - (x * i + y * j + z * k),
            w * i + v * x + (y * k - z * j),
            w * j + v * y + (z * i - x * k),
            w * k + v * z + (x * j - y * i),
        ]
    )


def inverse_matrices(q: Array) -> Array:
    """Return the (..., 3, 3) inverse rotation matrices R' of quaternions (4, ...)."""
    w, x, y, z = q
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
        [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def rotate_inverse(q: Array, vector: Array) -> Array:
    """Return R' v with R the rotation of q: the components of a fixed vector after the node turned by R."""
    u = -q[:, 1:]
    twice = 2 * cross(u, vector)
    return np.asarray(vector + q[:, :1] * twice + cross(u, twice))
