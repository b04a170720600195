"""Gyro calibration from turns between standstills, the reference for gyros too noisy to measure Earth rate.

It determines all six misalignments individually in the frame of the accelerometer triad, because a turn has a
direction and not only a magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.pose_observability import MAX_OBSERVABLE_SIGMA, WIDE_TOLERANCE
from hubodo.sensors.imu.turns import (
    NO_VALUES,
    Turns,
    propagate_gravity,
    propagate_gravity_jacobian,
    turn_errors,
)

MIN_TURN_COUNT = 3
MIN_TURN_ANGLE = 0.17
"""rad (10 degrees); in smaller turns the noise of the standstills dominates."""
OUTLIER_SIGMA = 6.0
"""Robust sigmas beyond which the error of a turn is due to saturation, a shock or a gap."""
_NOISE_DOF = 4.0
"""Degrees of freedom by which the noise of the standstills counts in the noise level of the turns."""
_RELINEARISE_CHANGE = 1e-6
"""Parameter change up to which the derivatives are not recomputed."""
_MATRIX_ELEMENTS = ("scale x", "xz", "xy", "yz", "scale y", "yx", "zy", "zx", "scale z")
_RATE_UNIT_OF_RATIO = {57.29578: "degrees per second", 57295.78: "mdps", 1000.0: "mrad/s"}


@dataclass(frozen=True)
class TurnCalibration:
    """The calibration of a gyro triad from T turns.

    Attributes:
        matrix: (3, 3) M in the frame of the accelerometer triad.
        bias_change: (3,) correction of the bias, rad/s.
        covariance: (12, 12) of the bias and of M row by row.
        response: (12, T, 3) derivative of the estimates by the misclosure of each turn, the vector (3,)
            from gravity measured by the accelerometers to gravity propagated by the gyros.
        is_observable: (9,) True for the elements of M that the turns determine; the others follow the
            prior.
        earth_rate, earth_covariance: (E,) and (E, E) horizontal Earth rates, rad/s, if modelled.
        used: (T,) number of each turn, from 0.
        angle: (T,) angle by which gravity turned, rad.
        error: (T,) angle between propagated and measured gravity after calibration, rad.
        dropped: one line for each turn that was excluded.
        terms, term_sigma: (K,) other terms, without prior, if modelled.
        scale_per_degree, scale_per_degree_sigma: (3,) change of the scales, 1/°C, if significant.
        mean_temperature: °C, at which the scales are stated.
    """

    matrix: Array
    bias_change: Array
    covariance: Array
    response: Array
    is_observable: NDArray[np.bool_]
    used: NDArray[np.int64]
    angle: Array
    error: Array
    dropped: tuple[str, ...] = ()
    earth_rate: Array = field(default_factory=lambda: NO_VALUES)
    earth_covariance: Array = field(default_factory=lambda: NO_VALUES)
    terms: Array = field(default_factory=lambda: NO_VALUES)
    term_sigma: Array = field(default_factory=lambda: NO_VALUES)
    scale_per_degree: Array | None = None
    scale_per_degree_sigma: Array | None = None
    mean_temperature: float = 0.0

    @property
    def deficit(self) -> str:
        """Return the unobservable elements and the turns that would determine them, or ""."""
        unobservable = [
            name
            for name, is_observable in zip(_MATRIX_ELEMENTS, self.is_observable, strict=True)
            if not is_observable
        ]
        if not unobservable:
            return ""
        axes = sorted({axis for name in unobservable for axis in name.replace("scale ", "") if axis in "xyz"})
        return (
            f"the turns do not determine {', '.join(unobservable)} of the gyro triad; add turns of 90 to "
            f"180 degrees about {' and '.join(axes)} with that axis level"
        )


def calibrate_from_turns(turns: Turns, bias_sigma: Array) -> TurnCalibration:
    """Estimate M of the gyros and a bias correction with the prior sigma `bias_sigma` (3,), rad/s.

    Raises CalibrationError if there are too few turns, if they determine no element of M, or if the unit of
    the gyros is wrong.
    """
    is_large = turns.angle > MIN_TURN_ANGLE
    measured = turns.defect == ""
    lost = turns.select(is_large & ~measured)
    dropped = [f"turn {k + 1}: {defect}" for k, defect in zip(lost.number, lost.defect, strict=True)]
    usable = turns.select(is_large & measured)
    if len(usable.dt) < MIN_TURN_COUNT:
        raise CalibrationError(
            f"only {len(usable.dt)} usable turns of more than 10 degrees between standstills, "
            f"{MIN_TURN_COUNT} are needed ({len(dropped)} clipped or with gaps); turn the node about each of "
            "its axes, in both directions, with standstills in between"
        )
    _check_unit(usable)
    p, covariance, response = _fit_turns(usable, bias_sigma)
    error = turn_errors(usable, *_split_parameters(p))
    # Rayleigh distribution: the median of the error is 1.18 times the sigma of each of its two components.
    is_outlier = error > OUTLIER_SIGMA * max(float(np.median(error)) / 1.1774, 1e-5)
    if is_outlier.any() and np.count_nonzero(~is_outlier) >= MIN_TURN_COUNT:
        dropped += [
            f"turn {k + 1}: error of {np.degrees(e):.2f} degrees"
            for k, e in zip(usable.number[is_outlier], error[is_outlier], strict=True)
        ]
        usable = usable.select(~is_outlier)
        p, covariance, response = _fit_turns(usable, bias_sigma)
    matrix, change, others = _split_parameters(p)
    count = 0 if usable.earth_slopes is None else usable.earth_slopes.shape[2]
    earth, terms = slice(12, 12 + count), slice(12 + count, None)
    is_observable = np.sqrt(np.diag(covariance)[:9]) <= MAX_OBSERVABLE_SIGMA
    order = [9, 10, 11, *range(9)]
    calibration = TurnCalibration(
        matrix,
        change,
        covariance[np.ix_(order, order)],
        response[order].reshape(12, -1, 3),
        is_observable,
        usable.number,
        usable.angle,
        turn_errors(usable, matrix, change, others),
        tuple(dropped),
        p[earth],
        covariance[earth, earth],
        p[terms],
        np.sqrt(np.diag(covariance)[terms]),
    )
    if not is_observable.any():
        raise CalibrationError(calibration.deficit)
    return calibration


def _split_parameters(p: Array) -> tuple[Array, Array, Array]:
    """Return M, the change of the bias, and the other unknowns: Earth rates and terms."""
    return np.eye(3) + p[:9].reshape(3, 3), p[9:12], p[12:]


def _fit_turns(turns: Turns, bias_sigma: Array) -> tuple[Array, Array, Array]:
    """Minimise the misclosures of all turns and the prior by Gauss-Newton, with an estimated noise level.

    Returns the parameters (P,), their covariance, and their response (P, 3 T) to the misclosures. P is 12,
    and one more for each horizontal Earth rate and other term.
    """
    other_slopes = turns.slopes
    earth_rates = 0 if turns.earth_slopes is None else turns.earth_slopes.shape[2]
    p, scatter = np.zeros(12 + other_slopes.shape[2]), 0.01
    prior_sigma = [np.full(9, WIDE_TOLERANCE.scale_and_angle), bias_sigma]
    prior_precision = np.zeros(len(p))
    prior_precision[: 12 + earth_rates] = (
        np.concatenate([*prior_sigma, np.full(earth_rates, turns.earth_sigma)]) ** -2
    )

    def linearise(p: Array) -> tuple[Array, Array]:
        matrix, change, others = _split_parameters(p)
        end, slopes = propagate_gravity_jacobian(turns, matrix, change)
        return end - turns.end - other_slopes @ others, np.concatenate([slopes, -other_slopes], axis=2)

    misclosure, slopes = linearise(p)
    for _ in range(12):
        jacobian = slopes.reshape(-1, len(p)) / scatter
        information = jacobian.T @ jacobian + np.diag(prior_precision)
        response = -np.linalg.solve(information, jacobian.T) / scatter
        step = response @ misclosure.ravel() - np.linalg.solve(information, prior_precision * p)
        p = p + step
        if np.abs(step).max() > _RELINEARISE_CHANGE:
            misclosure, slopes = linearise(p)
        else:
            matrix, change, others = _split_parameters(p)
            misclosure = propagate_gravity(turns, matrix, change) - turns.end - other_slopes @ others
        # A misclosure has two components, because gravity is a unit vector.
        parameters_used = -float(np.trace(response @ jacobian)) * scatter
        dof = max(1.0, 2 * len(misclosure) - parameters_used)
        squares = float((misclosure**2).sum())
        expected = (squares + _NOISE_DOF * turns.noise**2) / (dof + _NOISE_DOF)
        new_scatter = max(float(np.sqrt(max(expected, squares / dof))), 1e-7)
        converged = np.abs(step[:9]).max() < 1e-8 and abs(new_scatter / scatter - 1) < 1e-3
        scatter = new_scatter
        if converged:
            # The noise level is estimated from few turns, hence the variance of Student's t distribution.
            covariance = np.asarray(np.linalg.inv(information) * (1.0 + 2.0 / (dof + _NOISE_DOF - 2.0)))
            return p, covariance, np.asarray(response)
    raise CalibrationError(
        "the gyro calibration by turns does not converge; check that the gyro is in rad/s and that its axes "
        "are those of the accelerometer"
    )


def _check_unit(turns: Turns) -> None:
    """Raise CalibrationError if gravity does not turn by about the integrated rate: the unit is wrong."""
    swept_angle = np.linalg.norm(turns.rate * turns.dt[..., None], axis=2).sum(axis=1)
    ratio = float(np.median(swept_angle / turns.angle))
    if ratio > 20:
        unit = min(_RATE_UNIT_OF_RATIO, key=lambda factor: abs(np.log(ratio / factor)))
        raise CalibrationError(
            f"the integrated gyro rates are {ratio:.0f} times the turns of gravity, as if they were in "
            f"{_RATE_UNIT_OF_RATIO[unit]}; convert the record to rad/s"
        )
    if ratio < 0.5:
        raise CalibrationError(
            f"the integrated gyro rates are {ratio:.2g} of the turns of gravity; check their unit (rad/s) "
            "and range"
        )
