"""Record length needed to detect a noise term of a given size."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.allan.covariance import avar_covariance, covariance_tensor, design_matrix
from hubodo.sensors.allan.deviation import AllanPoints, averaging_factors
from hubodo.sensors.allan.likelihood import R, slope_sigma

_DETECTION_SIGMA = 3.0
_MAX_DOUBLINGS = 12


def required_record_length(
    term: int, size: float, theta: Array, points: AllanPoints, min_record_per_tau: int
) -> float | None:
    """Return the record length in s, to a factor of 2, at which a term of this size is detected at 3 sigma.

    theta: (5,) squares of the terms present. min_record_per_tau: record length in units of the longest
    averaging time used. Returns None if more than 4096 times the length of this record would be needed.
    """
    shortest, longest = 1, _MAX_DOUBLINGS + 1
    while shortest < longest:
        doublings = (shortest + longest) // 2
        if _is_detectable(term, size, theta, points.samples << doublings, points.dt, min_record_per_tau):
            longest = doublings
        else:
            shortest = doublings + 1
    return None if shortest > _MAX_DOUBLINGS else float((points.samples << shortest) * points.dt)


def _is_detectable(
    term: int, size: float, theta: Array, samples: int, dt: float, min_record_per_tau: int
) -> bool:
    if term == R:
        return bool(size > _DETECTION_SIGMA * slope_sigma(theta, samples * dt))
    present = theta.copy()
    present[term] = size**2
    matrix, tensor = _octave_points(samples, dt, min_record_per_tau)
    # Terms that contribute less than 0.1 % to every point are unobservable and would make the information
    # singular.
    active = np.flatnonzero(np.max(matrix * present / (matrix @ present)[:, None], axis=0) > 1e-3)
    if term not in active:
        return False
    # Cramér-Rao bound: the inverse Fisher information of Gaussian points with known covariance.
    sensitivity = matrix[:, active] * present[active]
    information = sensitivity.T @ np.linalg.solve(avar_covariance(tensor, present), sensitivity)
    variance = np.diag(np.linalg.inv(information))[int(np.flatnonzero(active == term)[0])]
    return bool(0.0 < variance < 1.0 / _DETECTION_SIGMA**2)


@lru_cache(maxsize=2 * _MAX_DOUBLINGS)
def _octave_points(samples: int, dt: float, min_record_per_tau: int) -> tuple[Array, Array]:
    """Return design matrix and covariance tensor of a record of this length.

    Cached, because all terms need them.
    """
    factors = averaging_factors(samples)
    factors = factors[factors <= samples // min_record_per_tau]
    return design_matrix(np.asarray(factors * dt, np.float64)), covariance_tensor(factors, samples, dt)
