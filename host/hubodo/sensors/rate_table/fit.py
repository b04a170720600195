"""Scale factor, asymmetry, nonlinearity and hysteresis of a gyro from the plateaus of a rate table.

The mean reading m of each rate is estimated beside a linear drift of the bias and the difference h of
plateaus that were approached from below and from above: y = m(rate) + drift (t - t0) + h d, with d = 1/2 or
-1/2, and noise that includes a random walk of the bias. All figures of the standards are linear in m, so
their sigmas follow from its covariance, whether the gyro is linear or not: scale factor and bias of the
least-squares line over all rates; asymmetry, the difference of the scale factors of both directions relative
to their mean, from a line with an additional term in |rate|; nonlinearity, the deviations of m from the line.

References
----------
IEEE Std 528-2019 (terms); IEEE Std 952-2020 and 1431-2004, scale factor tests on a rate table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.north.drift import random_walk_covariance
from hubodo.sensors.rate_table.plateaus import Plateaus, distinct_rates

_MIN_RATES = 4
_MIN_DOF = 3
_MAX_CHANCE = 0.01
_MAX_COLUMN_CONDITION = 1e4
_MAX_NOISE_FACTOR, _MAX_MISFIT = 10.0, 5e-4
"""Misfit of repeated rates, in units of their noise and of the largest rate, above which the rates are not
those of the table.
"""
_SLOPE_RANGE = (0.5, 2.0)
_WALK_RATIOS = (0.0, *np.logspace(-1, 7, 49))
"""Variance of the bias walk at the end of the record, relative to that of the mean of a plateau."""


@dataclass(frozen=True)
class RateTableFit:
    """The figures of one gyro axis; J rates.

    Attributes:
        bias: rad/s, Earth rate included. scale_error, asymmetry: relative.
        drift: of the bias, rad/s²; None if it cannot be separated.
        hysteresis: reading approached from below minus from above, rad/s; None if no rate was approached both
            ways.
        rates, deviation, deviation_sigma: (J,) rates, and deviations of the readings from the line, rad/s.
        nonlinearity: largest deviation, rad/s, and its sigma. nonlinearity_p_value: of all deviations.
        noise_factor: misfit of repeated rates relative to the noise of the plateaus.
    """

    bias: Quantity
    scale_error: Quantity
    asymmetry: Quantity | None
    drift: Quantity | None
    hysteresis: Quantity | None
    rates: Array
    deviation: Array
    deviation_sigma: Array
    nonlinearity: Quantity
    nonlinearity_p_value: float
    noise_factor: float


def fit_rate_table(plateaus: Plateaus) -> RateTableFit:
    """Return the figures of the plateaus. Raises CalibrationError if their rates do not suffice."""
    rates, cell = distinct_rates(plateaus.rate)
    if len(rates) < _MIN_RATES or rates[0] >= 0.0 or rates[-1] <= 0.0:
        raise CalibrationError(
            f"the table turned at {len(rates)} rates, {np.degrees(rates[0]):.4g} to "
            f"{np.degrees(rates[-1]):.4g} deg/s; {_MIN_RATES} or more are needed, in both directions"
        )
    means, covariance, others, factor = _fit_cells(plateaus, cell, len(rates))
    _check_repetition(factor, plateaus)
    # The plateaus of one rate use the same codes, so their mean has the error of one.
    covariance = covariance + plateaus.uneven**2 * np.eye(len(rates))
    line = np.linalg.pinv(np.column_stack([np.ones(len(rates)), rates]))
    _check_slope(float(line[1] @ means))
    residual = np.eye(len(rates)) - np.column_stack([np.ones(len(rates)), rates]) @ line
    deviation = residual @ means
    deviation_covariance = residual @ covariance @ residual.T
    sigma = np.sqrt(np.diag(deviation_covariance))
    worst = int(np.argmax(np.abs(deviation)))
    chi2 = float(deviation @ np.linalg.pinv(deviation_covariance, rcond=1e-10, hermitian=True) @ deviation)
    return RateTableFit(
        _functional(line[0], means, covariance),
        _functional(line[1], means, covariance, offset=-1.0),
        _asymmetry(rates, means, covariance),
        others["drift"],
        others["hysteresis"],
        rates,
        deviation,
        sigma,
        Quantity(float(deviation[worst]), float(sigma[worst])),
        float(chdtrc(len(rates) - 2, chi2)),
        factor,
    )


def _fit_cells(
    plateaus: Plateaus, cell: NDArray[np.int64], count: int
) -> tuple[Array, Array, dict[str, Quantity | None], float]:
    """Return the (J,) mean readings, their covariance, drift and hysteresis, and the noise factor."""
    columns = np.eye(count)[cell]
    names: list[str] = []
    direction = np.sign(np.diff(cell, prepend=cell[:1])) / 2.0
    for name, column in (("drift", plateaus.t - plateaus.t.mean()), ("hysteresis", direction)):
        trial = np.column_stack([columns, column])
        norm = np.maximum(np.linalg.norm(trial, axis=0), 1e-300)
        if trial.shape[1] < len(cell) and np.linalg.cond(trial / norm) < _MAX_COLUMN_CONDITION:
            columns, names = trial, [*names, name]
    solution, covariance, noise_factor = _solve_with_walk(columns, plateaus)
    others: dict[str, Quantity | None] = {"drift": None, "hysteresis": None}
    for k, name in enumerate(names):
        others[name] = Quantity(float(solution[count + k]), float(np.sqrt(covariance[count + k, count + k])))
    return solution[:count], covariance[:count, :count], others, noise_factor


def _solve_with_walk(columns: Array, plateaus: Plateaus) -> tuple[Array, Array, float]:
    """Return the parameters of the design (K, P), their covariance, and the factor of the white noise.

    The bias is a random walk of unknown size: the estimates for each size of a grid are averaged by their
    restricted likelihoods (Patterson, Thompson 1971).
    """
    dof = len(columns) - columns.shape[1]
    half = plateaus.duration / 2
    walk = random_walk_covariance(plateaus.t - half, plateaus.t + half)
    walk /= walk.max()
    estimates, covariances, factors, log_likelihoods = [], [], [], []
    for ratio in _WALK_RATIOS if dof >= _MIN_DOF else _WALK_RATIOS[:1]:
        noise = np.diag(plateaus.sigma**2) + ratio * np.median(plateaus.sigma) ** 2 * walk
        root = np.linalg.cholesky(noise)
        design, reading = np.linalg.solve(root, columns), np.linalg.solve(root, plateaus.reading)
        information = design.T @ design
        inverse = np.linalg.inv(information)
        solution = inverse @ (design.T @ reading)
        misfit = float(((reading - design @ solution) ** 2).sum())
        # A walk explains a misfit by itself: its size is then the only unknown of the noise.
        factor = max(1.0, misfit / max(dof, 1)) if ratio == 0.0 else 1.0
        log_likelihoods.append(
            -np.log(np.diag(root)).sum()
            - np.linalg.slogdet(information)[1] / 2
            - (dof * np.log(factor) + misfit / factor) / 2
        )
        # Where chance does not explain the misfit, the noise is an estimate: the variance of Student's t.
        if dof >= _MIN_DOF and ratio == 0.0 and chdtrc(dof, misfit) < _MAX_CHANCE:
            factor = misfit / (dof - 2)
        estimates.append(solution)
        covariances.append(inverse * factor)
        factors.append(factor)
    weight = np.exp(np.array(log_likelihoods) - max(log_likelihoods))
    weight /= weight.sum()
    mean = weight @ np.array(estimates)
    spread = np.array(estimates) - mean
    covariance = np.einsum("g,gij->ij", weight, np.array(covariances)) + (spread.T * weight) @ spread
    return mean, np.asarray(covariance), float(np.sqrt(weight @ np.array(factors)))


def _asymmetry(rates: Array, means: Array, covariance: Array) -> Quantity | None:
    """Return 2 a / s of the least-squares curve b + s r + a |r|; None if zero and |r| are the same rate."""
    design = np.column_stack([np.ones(len(rates)), rates, np.abs(rates)])
    if np.linalg.cond(design / np.linalg.norm(design, axis=0)) > _MAX_COLUMN_CONDITION:
        return None
    curve = np.linalg.pinv(design)
    slope = float(curve[1] @ means)
    return _functional(2.0 * curve[2] / slope, means, covariance)


def _functional(row: Array, means: Array, covariance: Array, offset: float = 0.0) -> Quantity:
    return Quantity(float(row @ means) + offset, float(np.sqrt(row @ covariance @ row)))


def _check_repetition(factor: float, plateaus: Plateaus) -> None:
    """Raise CalibrationError if the readings of one rate contradict each other and no walk explains it."""
    misfit = factor * float(np.median(plateaus.sigma))
    largest = float(np.abs(plateaus.rate).max())
    if factor > _MAX_NOISE_FACTOR and misfit > _MAX_MISFIT * largest:
        raise CalibrationError(
            f"readings at the same rate differ by {np.degrees(misfit):.3g} deg/s (1σ), {factor:.0f} times "
            "their noise, and not as a bias that drifts: the table slips, or its rates are not those listed"
        )


def _check_slope(slope: float) -> None:
    degrees = float(np.radians(1.0))
    if degrees * _SLOPE_RANGE[0] < slope < degrees * _SLOPE_RANGE[1]:
        raise InputError(
            "the rates of the table are 57 times those of the gyro, as if in deg/s, and a column without "
            "a unit is read in rad/s: name it rate_deg_s"
        )
    if not _SLOPE_RANGE[0] < slope < _SLOPE_RANGE[1]:
        raise InputError(
            f"the gyro reads {slope:.3g} times the rate of the table: the axis points the other way, the "
            "unit differs, or times do not match; choose the axis, or correct the signs or units of the rates"
        )
