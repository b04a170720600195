"""Gyro calibration from turns between standstills: the integrated rate must rotate gravity from pose to pose.

This is the reference for gyros too noisy to measure Earth rate. It determines all six misalignments
individually in the frame of the accelerometer triad, because a turn has a direction and not only a
magnitude. With C the attitude (node to world), dC/dt = C [omega x], and gravity fixed in space, the
specific force in node axes after the turn is f_end = R' f_start, with R the product of exp([omega dt x])
over the turn.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.errors import CalibrationError
from hubodo.sensors.imu.pose_observability import MAX_OBSERVABLE_SIGMA, WIDE_TOLERANCE
from hubodo.sensors.imu.quaternions import (
    chain_product,
    chain_products_after,
    cross,
    inverse_matrices,
    quaternions_from_vectors,
    rotate_inverse,
)
from hubodo.sensors.imu.standstills import Standstills

MIN_TURN_COUNT = 3
MIN_TURN_ANGLE = 0.17
"""rad (10 degrees); in smaller turns the noise of the standstills dominates."""
OUTLIER_SIGMA = 6.0
"""Robust sigmas beyond which the error of a turn is due to saturation, a shock or a gap."""
_TURN_PADDING_S = 0.1
_MAX_INTERVAL = 0.1
"""Longest time between samples of a turn, s, unless all intervals are that long: in 0.3 s at 1 rad/s the mean
of two rates is wrong by up to a degree.
"""
_NOISE_DOF = 4.0
"""Degrees of freedom by which the noise of the standstills counts in the noise level of the turns."""
_RELINEARISE_CHANGE = 1e-6
"""Parameter change up to which the derivatives are not recomputed."""
_MATRIX_ELEMENTS = ("scale x", "xz", "xy", "yz", "scale y", "yx", "zy", "zx", "scale z")
_RATE_UNIT_OF_RATIO = {57.29578: "degrees per second", 57295.78: "mdps", 1000.0: "mrad/s"}


_NO_VALUES: Array = np.zeros(0)


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
    earth_rate: Array = field(default_factory=lambda: _NO_VALUES)
    earth_covariance: Array = field(default_factory=lambda: _NO_VALUES)
    terms: Array = field(default_factory=lambda: _NO_VALUES)
    term_sigma: Array = field(default_factory=lambda: _NO_VALUES)

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


@dataclass(frozen=True)
class Turns:
    """The gyro samples of T turns, padded to a common length L with steps of zero duration.

    Attributes:
        rate: (T, L, 3) mean rate of each step without bias, rad/s.
        change: (T, L, 3) change of the rate within each step, rad/s.
        dt: (T, L) duration of each step, s.
        start, end: (T, 3) unit vectors of gravity in node axes before and after the turn.
        number: (T,) number of the turn in the record.
        defect: (T,) why the gyros did not measure the turn (saturated, samples missing), or "".
        earth_slopes: (T, 3, E) derivatives of the misclosures by horizontal Earth rates, or None; see
            `earth_in_turns`.
        earth_sigma: prior sigma of these rates, rad/s.
        term_slopes: (T, 3, K) derivatives by other terms, or None; see `nonlinear_gyros`.
        noise: sigma of a component of the misclosure by the noise of the standstills, rad; few turns
            may fit by chance.
    """

    rate: Array
    change: Array
    dt: Array
    start: Array
    end: Array
    number: NDArray[np.int64]
    defect: NDArray[np.str_]
    earth_slopes: Array | None = None
    earth_sigma: float = 0.0
    noise: float = 0.0
    term_slopes: Array | None = None

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Turns:
        """Return the selected turns, by index or mask."""
        return Turns(
            self.rate[which],
            self.change[which],
            self.dt[which],
            self.start[which],
            self.end[which],
            self.number[which],
            self.defect[which],
            None if self.earth_slopes is None else self.earth_slopes[which],
            self.earth_sigma,
            self.noise,
            None if self.term_slopes is None else self.term_slopes[which],
        )

    @property
    def slopes(self) -> Array:
        """Return the (T, 3, E + K) derivatives of the misclosures by Earth rates and other terms."""
        parts = [it for it in (self.earth_slopes, self.term_slopes) if it is not None]
        return np.concatenate([np.zeros((*self.start.shape, 0)), *parts], axis=2)

    @property
    def angle(self) -> Array:
        """Return the (T,) angles by which gravity turned in node axes, rad."""
        return _angle_between(self.start, self.end)


def collect_turns(t: Array, gyro: Array, bias: Array, standstills: Standstills, gravity: Array) -> Turns:
    """Return the turns between consecutive standstills.

    t: (N,) s. gyro: (N, 3) uncalibrated, rad/s. bias: (3,), or (N, 3) if it depends on the specific force.
    gravity: (R, 3) calibrated accelerometer means of the standstills. Only the motion is included, which
    limits the effect of a residual bias.
    """
    unit = gravity / np.linalg.norm(gravity, axis=1)[:, None]
    step = float(np.median(np.diff(t)))
    pad = max(1, round(_TURN_PADDING_S / step))
    extreme = np.abs(gyro).max(axis=0)
    spans = [
        (int(standstills.end[k]) - 1 - pad, int(standstills.start[k + 1]) + 1 + pad)
        for k in range(len(standstills) - 1)
    ]
    spans = [(max(0, i), min(len(t), j)) for i, j in spans]
    length = max((j - i - 1 for i, j in spans), default=1)
    rate, change = np.zeros((2, len(spans), length, 3))
    dt = np.zeros((len(spans), length))
    defect = np.zeros(len(spans), "U40")
    max_interval = max(_MAX_INTERVAL, 1.5 * step)
    for k, (i, j) in enumerate(spans):
        w = gyro[i:j] - (bias if bias.ndim == 1 else bias[i:j])
        rate[k, : j - i - 1] = (w[1:] + w[:-1]) / 2
        change[k, : j - i - 1] = np.diff(w, axis=0)
        dt[k, : j - i - 1] = np.diff(t[i:j])
        interval = float(dt[k].max())
        if interval > max_interval:
            defect[k] = f"samples are missing for {interval:.2g} s"
        elif ((np.abs(gyro[i:j]) >= extreme * 0.9999).sum(axis=0) >= 4).any():
            defect[k] = "the gyro was clipped"
    noise = _misclosure_noise(standstills, gravity, float(dt.sum(axis=1).mean()) if spans else 0.0)
    return Turns(rate, change, dt, unit[:-1], unit[1:], np.arange(len(spans)), defect, noise=noise)


def _misclosure_noise(standstills: Standstills, gravity: Array, duration: float) -> float:
    """Return the sigma of a component of the misclosure of turns of `duration` s, rad.

    It has the error of two directions of gravity, and the random walk of the integrated rates.
    """
    direction = 2.0 * np.mean(standstills.accel_sigma**2) / np.mean((gravity**2).sum(axis=1))
    walk = np.mean(standstills.gyro_sigma**2 * standstills.duration[:, None])
    return float(np.sqrt(direction + walk * duration))


def turn_rotations(turns: Turns, matrix: Array, bias_change: Array | float = 0.0) -> Array:
    """Return the (T, 3, 3) rotations of the turns, from node axes after the turn to node axes before it."""
    total = chain_product(quaternions_from_vectors(_rotation_vectors(turns, matrix, bias_change))).T
    return np.stack([rotate_inverse(total, np.broadcast_to(e, turns.start.shape)) for e in np.eye(3)], axis=1)


def propagate_gravity(turns: Turns, matrix: Array, bias_change: Array | float = 0.0) -> Array:
    """Return the (T, 3) directions of gravity at the end of each turn, propagated by the gyros."""
    return rotate_inverse(
        chain_product(quaternions_from_vectors(_rotation_vectors(turns, matrix, bias_change))).T, turns.start
    )


def propagate_gravity_jacobian(turns: Turns, matrix: Array, bias_change: Array) -> tuple[Array, Array]:
    """Return `propagate_gravity` and its (T, 3, 12) derivatives by `matrix`, row by row, and `bias_change`.

    If the rotation vector a of a step changes by da, gravity u at the end changes by u x f with
    f = S' (1 - [a x] / 2 + [a x]² / 6) da, where S is the product of the later steps: the right Jacobian
    of SO(3) (Sola, Deray, Atchuthan 2018) to second order in a. The derivative of the coning term is
    neglected (relative size 1e-4).
    """
    angle = _rotation_vectors(turns, matrix, bias_change)
    total, later_products = chain_products_after(quaternions_from_vectors(angle))
    end = rotate_inverse(total.T, turns.start)
    x, y, z = 0.5 * np.moveaxis(angle, -1, 0)
    diagonal = 1.0 - (x * x + y * y + z * z) / 1.5
    jacobian_first_order = np.array([[diagonal, z, -y], [-z, diagonal, x], [y, -x, diagonal]])
    # [a x]² = a a' - a²
    step_effect = (
        np.moveaxis(jacobian_first_order, (0, 1), (-2, -1)) + angle[..., :, None] * angle[..., None, :] / 6.0
    )
    inverse = np.linalg.inv(matrix)
    step_effect = inverse_matrices(later_products) @ step_effect
    rates_and_bias = np.concatenate(
        [(turns.rate - bias_change) @ inverse.T, np.ones((*turns.dt.shape, 1))], axis=-1
    )
    rates_and_bias = rates_and_bias * turns.dt[..., None]
    # (T, 3, 4, 3): derivative of f by each column of the inverse, for each axis of the rate and for the bias.
    sums = (step_effect.reshape(*rates_and_bias.shape[:2], 9).transpose(0, 2, 1) @ rates_and_bias).reshape(
        -1, 3, 3, 4
    )
    sums = -sums.transpose(0, 1, 3, 2) @ inverse
    gravity_effect = np.concatenate(
        [sums[:, :, :3].transpose(0, 1, 3, 2).reshape(-1, 3, 9), sums[:, :, 3]], axis=-1
    )
    return end, np.cross(end[:, :, None], gravity_effect, axis=1)


def _rotation_vectors(turns: Turns, matrix: Array, bias_change: Array | float) -> Array:
    """Return the (T, L, 3) rotation vectors of the node in each step, rad."""
    inverse = np.linalg.inv(matrix)
    rate = (turns.rate - bias_change) @ inverse.T
    dt = turns.dt[..., None]
    # Second term: coning for a rate that changes linearly within the step, w0 x w1 dt²/12.
    return np.asarray(rate * dt + cross(rate, turns.change @ inverse.T) * dt**2 / 12)


def turn_errors(
    turns: Turns, matrix: Array, bias_change: Array | float = 0.0, others: Array = _NO_VALUES
) -> Array:
    """Return the (T,) angles between propagated and measured gravity, rad, less the effect of `others`.

    others: (E + K,) Earth rates and other terms, or none.
    """
    end = propagate_gravity(turns, matrix, bias_change)
    if len(others):
        end = end - turns.slopes @ others
    return _angle_between(end, turns.end)


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


def _angle_between(a: Array, b: Array) -> Array:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))
