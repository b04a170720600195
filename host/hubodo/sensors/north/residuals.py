"""What the fit of north leaves over of a record: for people to look at, and to see whether it is noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.linalg import cholesky, solve_triangular

from hubodo.arrays import Array
from hubodo.sensors.north.drift import covariance
from hubodo.sensors.north.find import North


@dataclass(frozen=True)
class Residuals:
    """M averages of all records in order.

    t: (M,) s, their middles. earth: (M,) rad/s measured, without bias and ramp; model: (M,) rad/s of Earth
    rate. angle: (M,) rad of the sensing axis. left: (M,) rad/s, earth - model, with the drift in it. white:
    (M,) the same divided by what noise and drift allow, unit variance where the fit holds.
    """

    t: Array
    earth: Array
    model: Array
    angle: Array
    left: Array
    white: Array


def residuals_of(found: North) -> Residuals:
    """The residuals at the azimuth and the drift that were found."""
    rows = []
    north = found.horizontal * np.array([np.cos(found.azimuth), np.sin(found.azimuth)])
    for averages in found.averages:
        cos, sin, _, _, y = averages.columns(0.0).T
        spread = covariance(found.posterior.drift, averages.start, averages.end)
        factor = cholesky(spread, lower=True)
        middle = (averages.start + averages.end) / 2
        model = np.column_stack([cos, sin]) @ north
        ramp = (middle - middle.mean()) / max(float(np.ptp(middle)), 1e-9)
        nuisance = legvander(2 * ramp, found.posterior.order)
        both = solve_triangular(factor, np.column_stack([nuisance, y - model]), lower=True)
        level = np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=None)[0]
        earth = y - nuisance @ level
        white = both[:, -1] - both[:, :-1] @ level
        rows.append(np.stack([middle, earth, model, np.arctan2(sin, cos), earth - model, white]))
    return Residuals(*np.concatenate(rows, axis=1))
