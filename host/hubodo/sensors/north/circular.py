"""Azimuth and sigma from a posterior density on the circle, for one gyro or several."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.north.likelihood import UNMEASURED_VARIANCE, EarthRatePosterior

_FLAT_TOP = 0.999
"""Density on the line of the stops, relative to the maximum, from which the maximum is on the line."""
_MAX_VALLEY_RATIO = 0.6
"""Density between two maxima, relative to the lower one, below which they are two candidates."""
_MIN_CANDIDATE_SHARE = 0.03
"""Smallest probability of a second candidate."""


def summarise_azimuth(
    posterior: EarthRatePosterior, near: float | None = None
) -> tuple[float, float, tuple[float, ...]]:
    """Return azimuth, sigma and candidates, rad, of a posterior on the circle.

    With one maximum the azimuth is the mean, with several the highest one, or the candidate next to `near`.
    sigma is the rms of the wrapped deviation; for stops along one line, whose two candidates mirror each
    other, it is the rms within the half circle of the azimuth. near: rad; directions more than 90 degrees
    from it are excluded.
    """
    azimuth, density = posterior.azimuth, posterior.density
    axis = single_measured_direction(posterior)
    if axis is not None:
        return _summarise_mirrored(azimuth, density, axis, near)
    if near is not None and (density[abs(wrap_angle(azimuth - near)) < np.pi / 2] > 0).any():
        density = np.where(abs(wrap_angle(azimuth - near)) < np.pi / 2, density, 0.0)
    candidates = _separate_maxima(azimuth, density)
    if len(candidates) == 1:
        candidates = (_circular_mean(azimuth, density),)
    return candidates[0], _circular_sigma(azimuth, density, candidates[0]), candidates


def _summarise_mirrored(
    azimuth: Array, density: Array, axis: float, near: float | None
) -> tuple[float, float, tuple[float, ...]]:
    """Return azimuth, sigma and both candidates of a posterior that is symmetric about a line.

    If its maximum is on the line, the line is the azimuth and the candidates are the means of both halves.
    axis: direction of the line, rad.
    """
    half_sign = np.sign(np.sin(azimuth[density.argmax()] - axis)) or 1.0
    half_density = np.where(np.sin(azimuth - axis) * half_sign >= -1e-9, density, 0.0)
    mean = _circular_mean(azimuth, half_density)
    highest = _highest_azimuth(azimuth, density, int(half_density.argmax()))
    line_direction = axis if np.cos(highest - axis) > 0 else float(wrap_angle(axis + np.pi))
    is_on_line = _density_at(line_direction, azimuth, density) > _FLAT_TOP * density.max()
    candidate = mean if is_on_line else highest
    mirror = float(wrap_angle(2 * axis - candidate))
    target = np.pi / 2 if near is None else near
    first, second = sorted((candidate, mirror), key=lambda one: abs(wrap_angle(one - target)))
    answer = line_direction if is_on_line and near is None else first
    # The density is computed about one candidate; that about the other one is its mirror image.
    centre = answer if answer in (line_direction, candidate) else candidate
    return answer, _circular_sigma(azimuth, half_density, centre), (first, second)


def _separate_maxima(azimuth: Array, density: Array) -> tuple[float, ...]:
    """Return the maxima, the highest first, that are separated by a valley and hold enough probability."""
    top = int(density.argmax())
    maxima = [_highest_azimuth(azimuth, density, top)]
    if np.ptp(azimuth) < np.pi:
        return tuple(maxima)
    ordered = np.roll(density, -top)
    angles = np.roll(azimuth, -top)
    # The nearest valleys on both sides bound the part of the circle that belongs to the maximum.
    rising = np.minimum.accumulate(ordered)
    falling = np.minimum.accumulate(ordered[::-1])[::-1]
    valley = np.maximum(rising, falling)
    outside = ordered > valley / _MAX_VALLEY_RATIO
    if outside.any() and ordered[outside].sum() > _MIN_CANDIDATE_SHARE * ordered.sum():
        maxima.append(float(angles[int(np.where(outside, ordered, 0.0).argmax())]))
    return tuple(maxima)


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


def _highest_azimuth(azimuth: Array, density: Array, top: int) -> float:
    """Return the maximum, rad, of a parabola through the log density at index `top` and its neighbours."""
    if not 0 < top < len(density) - 1 or not density[top - 1 : top + 2].all():
        return float(azimuth[top])
    before, at, after = np.log(density[top - 1 : top + 2])
    curvature = before - 2 * at + after
    shift = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
    return float(azimuth[top] + np.clip(shift, -0.5, 0.5) * (azimuth[top + 1] - azimuth[top]))


def _density_at(angle: float, azimuth: Array, density: Array) -> float:
    nearest = int(np.abs(wrap_angle(azimuth - angle)).argmin())
    return (
        float(density[nearest]) if abs(float(wrap_angle(azimuth[nearest] - angle))) < np.radians(0.5) else 0.0
    )


def _circular_mean(azimuth: Array, density: Array) -> float:
    return float(np.arctan2((density * np.sin(azimuth)).sum(), (density * np.cos(azimuth)).sum()))


def _circular_sigma(azimuth: Array, density: Array, mean: float) -> float:
    return float(np.sqrt((density * wrap_angle(azimuth - mean) ** 2).sum() / density.sum()))
