"""Azimuth and sigma from a probability over the circle, of one gyro or of several."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.north.ml import UNSEEN, Posterior


def summarise(posterior: Posterior, near: float | None = None) -> tuple[float, float, tuple[float, ...]]:
    """(azimuth, sigma, candidates), rad, of a posterior over the circle.

    sigma is the root mean square of the wrapped distance; with two candidates it is that about the one
    taken, over its own half. near: rad; what points away from it does not count.
    """
    a, p = posterior.azimuth, posterior.density
    axis = blind_axis(posterior)
    if axis is None:
        if near is not None and (p[abs(wrap(a - near)) < np.pi / 2] > 0).any():
            p = np.where(abs(wrap(a - near)) < np.pi / 2, p, 0.0)
        mean = _circular_mean(a, p)
        return mean, _circular_sigma(a, p, mean), (mean,)
    # Mirror images about the line of the stops are equally likely: judge the half of the peak, and mirror it.
    side = np.sign(np.sin(a[p.argmax()] - axis)) or 1.0
    half = np.where(np.sin(a - axis) * side >= 0, p, 0.0)
    mean = _circular_mean(a, half)
    sigma = _circular_sigma(a, half, mean)
    other = float(wrap(2 * axis - mean))
    apart = abs(float(wrap(mean - other)))
    line = axis if np.cos(mean - axis) > 0 else float(wrap(axis + np.pi))
    if _density_at(line, a, p) > np.exp(-2.0) * p.max():
        # Less than two sigma of a dip between them: the line points at north or south as well as can be told.
        return line, float(np.hypot(sigma, apart / 2)), (line,)
    target = np.pi / 2 if near is None else near
    first, second = sorted((mean, other), key=lambda candidate: abs(wrap(candidate - target)))
    return first, sigma, (first, second)


def fuse(found: Sequence[tuple[Posterior, float]], angle_sigma: float = 0.0) -> tuple[float, float]:
    """Azimuth and sigma, rad, of several gyros on one table, whose errors are independent of each other.

    found: posterior of each, and rad/s that it feels when it points north. The rates are added by their
    information, then held to that length. angle_sigma: rad, of the table's angles, which all share.
    """
    a = np.radians(np.arange(-180, 180, 0.02))
    log = np.zeros(len(a))
    for posterior, horizontal in found:
        off = horizontal * np.stack([np.cos(a), np.sin(a)]) - posterior.rate[:, None]
        log -= 0.5 * np.einsum("ik,ij,jk->k", off, np.linalg.inv(posterior.rate_covariance), off)
    p = np.exp(log - log.max())
    mean = _circular_mean(a, p)
    return mean, float(np.hypot(_circular_sigma(a, p, mean), angle_sigma))


def wrap(angle: Array | float) -> Array:
    """rad, into (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - np.asarray(angle), 2 * np.pi))


def blind_axis(posterior: Posterior) -> float | None:
    """Direction, rad, of the one line that was measured, or None when both components were."""
    values, vectors = np.linalg.eigh(posterior.rate_covariance)
    if values[1] < UNSEEN / 2:
        return None
    return float(np.arctan2(vectors[1, 0], vectors[0, 0]))


def _density_at(angle: float, a: Array, p: Array) -> float:
    nearest = int(np.abs(wrap(a - angle)).argmin())
    return float(p[nearest]) if abs(float(wrap(a[nearest] - angle))) < np.radians(0.5) else 0.0


def _circular_mean(a: Array, p: Array) -> float:
    return float(np.arctan2((p * np.sin(a)).sum(), (p * np.cos(a)).sum()))


def _circular_sigma(a: Array, p: Array, mean: float) -> float:
    return float(np.sqrt((p * wrap(a - mean) ** 2).sum() / p.sum()))
