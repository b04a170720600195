"""How long a record would have to be to show a noise term of a given size."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hubodo.sensors.allan.covariance import covariance_tensor, design, point_covariance
from hubodo.sensors.allan.deviation import AllanPoints, averaging_factors
from hubodo.sensors.allan.likelihood import R, slope_sigma

FloatArray = NDArray[np.float64]

_SIGMAS = 3.0
_DOUBLINGS = 12


def needed_length(term: int, size: float, theta: FloatArray, points: AllanPoints, parts: int) -> float | None:
    """Record length in s, to a factor of 2, in which a term of this size would stand at 3 sigma.

    theta: (5,) squares of the terms there are; parts: into how many the longest averaging time divides a
    record. None beyond 4096 times this record.
    """
    shortest, longest = 1, _DOUBLINGS + 1
    while shortest < longest:
        doublings = (shortest + longest) // 2
        if _seen(term, size, theta, points.samples << doublings, points.dt, parts):
            longest = doublings
        else:
            shortest = doublings + 1
    return None if shortest > _DOUBLINGS else float((points.samples << shortest) * points.dt)


def _seen(term: int, size: float, theta: FloatArray, samples: int, dt: float, parts: int) -> bool:
    if term == R:
        return bool(size > _SIGMAS * slope_sigma(theta, samples * dt))
    present = theta.copy()
    present[term] = size**2
    matrix, tensor = _octaves(samples, dt, parts)
    # What no point shows has no part in it.
    active = np.flatnonzero(np.max(matrix * present / (matrix @ present)[:, None], axis=0) > 1e-3)
    if term not in active:
        return False
    # The inverse of Fisher's information of points whose covariance is known.
    part = matrix[:, active] * present[active]
    information = part.T @ np.linalg.solve(point_covariance(tensor, present), part)
    variance = np.diag(np.linalg.inv(information))[int(np.flatnonzero(active == term)[0])]
    return bool(0.0 < variance < 1.0 / _SIGMAS**2)


@lru_cache(maxsize=2 * _DOUBLINGS)
def _octaves(samples: int, dt: float, parts: int) -> tuple[FloatArray, FloatArray]:
    """Design and covariance of a record of this length; kept, as all terms ask for the same."""
    factors = averaging_factors(samples)
    factors = factors[factors <= samples // parts]
    return design(np.asarray(factors * dt, np.float64)), covariance_tensor(factors, samples, dt)
