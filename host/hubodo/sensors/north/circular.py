"""Azimuth and sigma from a posterior density on the circle, for one gyro or several."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.north.likelihood import UNMEASURED_VARIANCE, EarthRatePosterior


def summarise_azimuth(
    posterior: EarthRatePosterior, near: float | None = None
) -> tuple[float, float, tuple[float, ...]]:
    """Return azimuth, sigma and candidates, rad, of a posterior on the circle.

    sigma is the rms of the wrapped deviation; with two candidates it is that of the selected one, over its
    half of the circle. near: rad; directions more than 90 degrees from it are excluded.
    """
    azimuth, density = posterior.azimuth, posterior.density
    axis = single_measured_direction(posterior)
    if axis is None:
        if near is not None and (density[abs(wrap_angle(azimuth - near)) < np.pi / 2] > 0).any():
            density = np.where(abs(wrap_angle(azimuth - near)) < np.pi / 2, density, 0.0)
        mean = _circular_mean(azimuth, density)
        return mean, _circular_sigma(azimuth, density, mean), (mean,)
    # The posterior is symmetric about the line of the stops: evaluate the half with the peak, and mirror it.
    half_sign = np.sign(np.sin(azimuth[density.argmax()] - axis)) or 1.0
    half_density = np.where(np.sin(azimuth - axis) * half_sign >= 0, density, 0.0)
    mean = _circular_mean(azimuth, half_density)
    sigma = _circular_sigma(azimuth, half_density, mean)
    mirror = float(wrap_angle(2 * axis - mean))
    separation = abs(float(wrap_angle(mean - mirror)))
    line_direction = axis if np.cos(mean - axis) > 0 else float(wrap_angle(axis + np.pi))
    if _density_at(line_direction, azimuth, density) > np.exp(-2.0) * density.max():
        # The dip between the candidates is less than two sigma: the line points to north or south within
        # its sigma.
        return line_direction, float(np.hypot(sigma, separation / 2)), (line_direction,)
    target = np.pi / 2 if near is None else near
    first, second = sorted((mean, mirror), key=lambda candidate: abs(wrap_angle(candidate - target)))
    return first, sigma, (first, second)


def fuse_azimuths(
    gyros: Sequence[tuple[EarthRatePosterior, float]], angle_sigma: float = 0.0
) -> tuple[float, float]:
    """Return azimuth and sigma, rad, of several gyros with independent errors on one table.

    gyros: posterior of each gyro, and Earth rate along it when it points north, rad/s. The rates are
    combined by their information matrices under the constraint of that norm. angle_sigma: common sigma of
    the table angles, rad.
    """
    azimuth = np.radians(np.arange(-180, 180, 0.02))
    log = np.zeros(len(azimuth))
    for posterior, horizontal in gyros:
        rate_error = horizontal * np.stack([np.cos(azimuth), np.sin(azimuth)]) - posterior.rate[:, None]
        log -= 0.5 * np.einsum(
            "ik,ij,jk->k", rate_error, np.linalg.inv(posterior.rate_covariance), rate_error
        )
    density = np.exp(log - log.max())
    mean = _circular_mean(azimuth, density)
    return mean, float(np.hypot(_circular_sigma(azimuth, density, mean), angle_sigma))


def wrap_angle(angle: Array | float) -> Array:
    """Wrap angles, rad, into (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - np.asarray(angle), 2 * np.pi))


def single_measured_direction(posterior: EarthRatePosterior) -> float | None:
    """Return the direction, rad, of the only component measured, or None if both were measured."""
    values, vectors = np.linalg.eigh(posterior.rate_covariance)
    if values[1] < UNMEASURED_VARIANCE / 2:
        return None
    return float(np.arctan2(vectors[1, 0], vectors[0, 0]))


def _density_at(angle: float, azimuth: Array, density: Array) -> float:
    nearest = int(np.abs(wrap_angle(azimuth - angle)).argmin())
    return (
        float(density[nearest]) if abs(float(wrap_angle(azimuth[nearest] - angle))) < np.radians(0.5) else 0.0
    )


def _circular_mean(azimuth: Array, density: Array) -> float:
    return float(np.arctan2((density * np.sin(azimuth)).sum(), (density * np.cos(azimuth)).sum()))


def _circular_sigma(azimuth: Array, density: Array, mean: float) -> float:
    return float(np.sqrt((density * wrap_angle(azimuth - mean) ** 2).sum() / density.sum()))
