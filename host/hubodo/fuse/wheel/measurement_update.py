"""Kalman update of the wheel filter with the measurements of one window of all wheels."""

from __future__ import annotations

from operator import add
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dgemm
from scipy.linalg.lapack import dpotrf, dtrtri

from hubodo.arrays import Array
from hubodo.fuse.wheel import mounting_check
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import (
    GYRO_BIAS_X,
    GYRO_BIAS_Y,
    MISALIGNMENT_X,
    MISALIGNMENT_Y,
    OBSERVABLE_WHEN_ROLLING,
    OBSERVABLE_WHEN_TURNING,
    RATE_BEYOND_RANGE,
    SLOPE,
    WHEEL_ANGLE,
    WHEEL_RADIUS,
    YAW_RATE,
    StateLayout,
)
from hubodo.fuse.wheel.measurement_rows import MeasurementRows
from hubodo.fuse.wheel.measurements import (
    WindowNoise,
    forward,
    roll,
    rolling,
    yaw,
)
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.records import MeasurementTerms, WheelWindows
from hubodo.fuse.wheel.slip_detector import ForwardResidual
from hubodo.fuse.wheel.thresholds import GATE_SIGMA
from hubodo.fuse.wheel.wheel import Wheel, WheelMode
from hubodo.fuse.wheel.window import WINDOW_S

_GAP_VARIANCE_FACTOR = 1e4
"""Variance factor of a window that is all gap, beyond any information of a row. Estimated."""


_RATE_ERROR_ENTRIES = (GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_Y, MISALIGNMENT_X)
"""Errors of the gyros across the axle that are rotated by the wheel angle."""


class UpdateResult(NamedTuple):
    """States after the update, and the statistics of the measurements.

    Attributes
    ----------
    x, p : states and covariance.
    nis, dof : normalised innovation squared and its degrees of freedom.
    rolling_rates : rad/s of each wheel.
    yaw_rates : rad/s of the vehicle as measured by each wheel's gyro.
    forward_residuals : acceleration of each wheel against the specific force at its hub; None if not
    observable.
    outlier_wheel : index of the wheel that the other one contradicts, or None.
    motion_state : motion state that was assumed.
    terms : terms for smoothing; None if they are not wanted, or no measurement was used.
    """

    x: list[float]
    p: Array
    nis: float
    dof: int
    rolling_rates: list[float]
    yaw_rates: list[float]
    forward_residuals: list[ForwardResidual | None]
    outlier_wheel: int | None
    motion_state: MotionState
    terms: MeasurementTerms | None = None


class MeasurementUpdate:
    """The measurements of one window of each wheel and their Kalman update; stateless."""

    def __init__(self, config: WheelConfig, columns: StateLayout, wants_residuals: bool = True) -> None:
        """Prepare the layout; wants_residuals: compute forward residuals for slip detection."""
        self.wants_residuals = wants_residuals
        self._rows = MeasurementRows(columns)
        self._noise = WindowNoise(config.noise, config.radius)
        self._measures = [measurement.measure for measurement in self._rows.measurements]
        self._yaw = self._rows.measurements.index(yaw)
        wheels = range(len(columns.wheels))
        self._rolling_block, self._turning_block = (
            [np.ix_(self._rows.rows_of_wheel(wheel), columns.columns_of(wheel, entries)) for wheel in wheels]
            for entries in (OBSERVABLE_WHEN_ROLLING, OBSERVABLE_WHEN_TURNING)
        )
        self._slope, self._yaw_rate = columns.vehicle[SLOPE], columns.vehicle[YAW_RATE]
        self._forward_rows = [self._rows.row_of(forward, wheel) for wheel in wheels]
        self._rate_error_columns = [columns.columns_of(wheel, _RATE_ERROR_ENTRIES) for wheel in wheels]
        self._compared = tuple(
            (self._rows.row_of(yaw, wheel), self._rows.row_of(rolling, wheel)) for wheel in wheels
        )

    def update(
        self,
        x: list[float],
        p: Array,
        windows: WheelWindows,
        motion_state: MotionState,
        wants_terms: bool = False,
    ) -> UpdateResult:
        """Update states x (n,) and covariance p (n, n), C-contiguous, which may be overwritten.

        wants_terms: return the terms for smoothing.
        """
        values, rolling_rates, yaw_rates, is_clear, silent = self._collect_rows(
            x, windows, motion_state is MotionState.STANDSTILL
        )
        outlier_wheel = None
        h, z, r = self._rows.fill(values)
        for index, (wheel, window) in enumerate(windows):
            if window.all_clipped:
                self._add_products(p, h, r, wheel, index)
        self._clear_unobservable(h, windows, motion_state, rolling_rates)
        # `dot` takes half the time of `@` on matrices of this size.
        hp = h.dot(p)
        forward_residuals = [
            self._forward_residual((x, p), (h, hp, z, r), wheel, index)
            if is_clear[index] and self.wants_residuals
            else None
            for index, (wheel, _) in enumerate(windows)
        ]
        if silent:
            active_rows = [row for row in range(len(z)) if row not in silent]
            if not active_rows:
                return UpdateResult(
                    x, p, 0.0, 0, rolling_rates, yaw_rates, forward_residuals, None, motion_state
                )
            h, hp, z, r = h[active_rows], hp[active_rows], z[active_rows], r[active_rows]
        s = hp.dot(h.T)
        diagonal = s.ravel()[:: len(z) + 1]
        diagonal += r
        whitening = _whitening(s)
        whitened = whitening.dot(z)
        nis = float(whitened.dot(whitened))
        if max(map(abs, whitened.tolist())) > GATE_SIGMA:
            sigma = 1.0 / whitening.diagonal()
            compared = self._compared if len(windows) == 2 and not silent else None
            inflated_variances, outlier_wheel = mounting_check.inflate_outlier_variances(
                whitened, sigma, z, r, compared
            )
            if inflated_variances is not r:
                diagonal += inflated_variances - r
                whitening = _whitening(s)
                whitened = whitening.dot(z)
                nis = float(whitened.dot(whitened))
        gain_root = whitening.dot(hp)
        terms = MeasurementTerms(whitened, whitening.dot(h), gain_root) if wants_terms else None
        unobservable = _unobservable_states(x, p, windows)
        x = list(map(add, x, whitened.dot(gain_root).tolist()))
        # p - root' root in one call. BLAS is column-major, so `.T` passes the array without a copy.
        p = dgemm(-1.0, gain_root.T, gain_root.T, beta=1.0, c=p.T, trans_b=1, overwrite_c=1).T
        _restore_states(x, p, unobservable)
        return UpdateResult(
            x, p, nis, len(z), rolling_rates, yaw_rates, forward_residuals, outlier_wheel, motion_state, terms
        )

    def _collect_rows(
        self, x: list[float], windows: WheelWindows, is_stationary: bool
    ) -> tuple[list[float], list[float], list[float], list[bool], list[int]]:
        """Return row values, rolling rates, yaw rates, undisturbed windows, and unused rows."""
        values: list[float] = []
        rolling_rates: list[float] = []
        yaw_rates: list[float] = []
        is_clear: list[bool] = []
        silent: list[int] = []
        noise, measures, append = self._noise, self._measures, values.extend
        for index, (wheel, window) in enumerate(windows):
            view = wheel.view
            view.linearise(
                x, window, is_stationary, wheel.standstill.noise, wheel.standstill.force_noise_of(window)
            )
            if wheel.geometry.delay_factor:
                view.update_yaw_change()
            residuals: list[float] = []
            variances: list[float] = []
            for measure in measures:
                residual, variance, derivatives = measure(view, noise)
                append(derivatives.values())
                residuals.append(residual)
                variances.append(variance)
            values += residuals
            if window.missing > 0.0:
                # Integrals across a gap are interpolated: their information decreases with the missing
                # share.
                share = 1.0 + _GAP_VARIANCE_FACTOR * window.missing
                variances = [variance * share for variance in variances]
            values += variances
            is_clear.append(wheel.angle_initialised and window.missing == 0.0 and not window.any_clipped)
            rolling_rates.append(view.rolling_rate)
            yaw_rates.append(view.yaw_rate + residuals[self._yaw] / WINDOW_S / view.camber_cos)
            mode = wheel.mode(window)
            if mode is not WheelMode.ROLLING or not is_clear[index]:
                silent += self._rows.unused_rows(index, mode, window)
        return values, rolling_rates, yaw_rates, is_clear, silent

    def _clear_unobservable(
        self, h: Array, windows: WheelWindows, motion_state: MotionState, rolling_rates: list[float]
    ) -> None:
        """Clear the derivatives, in place, by entries that the motion does not show.

        At standstill they are pure noise, which minutes of data would turn into false certainty.
        """
        is_stationary = motion_state is not MotionState.MOVING
        for index, (wheel, _) in enumerate(windows):
            if is_stationary or rolling_rates[index] ** 2 < GATE_SIGMA**2 * wheel.standstill.noise:
                h[self._rolling_block[index]] = 0.0
            if is_stationary:
                h[self._turning_block[index]] = 0.0

    def _add_products(self, p: Array, h: Array, r: Array, wheel: Wheel, index: int) -> None:
        """Add to yaw and roll the second-order terms of a spin that is estimated while the gyro is clipped.

        A wrong wheel angle rotates wrong biases and tilts: variance of a product of two independent errors
        (Gaussian second-order filter, Jazwinski 1970, section 9.3). The tilt also leaks the spin error, as
        new noise in each window.
        """
        angle, excess = wheel.columns[WHEEL_ANGLE], wheel.columns[RATE_BEYOND_RANGE]
        by_middle_angle = np.zeros(len(p))
        by_middle_angle[angle], by_middle_angle[excess] = 1.0, 0.5 * WINDOW_S
        angle_variance = float(by_middle_angle @ p @ by_middle_angle)
        first, second = self._rows.row_of(yaw, index), self._rows.row_of(roll, index)
        let_in = self._rate_error_columns[index]
        error_covariance = p[np.ix_(let_in, let_in)]
        by_yaw, by_roll = h[first, let_in], h[second, let_in]
        x, at = wheel.view.x, wheel.columns
        tilt = x[at[MISALIGNMENT_X]] ** 2 + x[at[MISALIGNMENT_Y]] ** 2
        spin_leak_variance = p[excess, excess] * tilt * abs(wheel.view.carrier) ** 2
        r[first] += angle_variance * float(by_roll @ error_covariance @ by_roll) + spin_leak_variance
        r[second] += angle_variance * float(by_yaw @ error_covariance @ by_yaw) + spin_leak_variance

    def _forward_residual(
        self, states: tuple[list[float], Array], rows: tuple[Array, ...], wheel: Wheel, index: int
    ) -> ForwardResidual:
        """Return the forward residual of a wheel; the yaw rate, free in each window, counts as known."""
        (x, p), (h, hp, z, r) = states, rows
        row, free = self._forward_rows[index], self._yaw_rate
        by_free = h.item(row, free)
        common = float(hp[row].dot(h[row])) - by_free * (
            2.0 * hp.item(row, free) - by_free * p.item(free, free)
        )
        gain = wheel.geometry.radius * wheel.view.axle_rate_change
        return ForwardResidual(z.item(row), r.item(row), gain, common, x[self._slope], x[self._yaw_rate])


class _States(NamedTuple):
    """Columns, values and covariance block of a subset of the states."""

    columns: list[int]
    values: list[float]
    block: Array


def _unobservable_states(x: list[float], p: Array, windows: WheelWindows) -> _States | None:
    """Return the columns of the radii of wheels with a saturated gyro; None if there are none.

    Their rate is searched in each window, so rolling carries no information about the radius; unmodelled
    acceleration would move it by 5 sigma.
    """
    columns = [wheel.columns[WHEEL_RADIUS] for wheel, window in windows if window.all_clipped]
    if not columns:
        return None
    return _States(columns, [x[column] for column in columns], p[np.ix_(columns, columns)])


def _restore_states(x: list[float], p: Array, states: _States | None) -> None:
    """Restore states that measurements depend on but must not correct (Schmidt-Kalman update), in place."""
    if states is None:
        return
    for column, value in zip(states.columns, states.values, strict=True):
        x[column] = value
    p[np.ix_(states.columns, states.columns)] = states.block


def _whitening(s: Array) -> Array:
    """Return the inverse of the lower Cholesky factor of the innovation covariance.

    It whitens each innovation given those before it. (Solving with the factor instead wakes the threads of
    BLAS, a hundred times slower.)
    """
    factor, _ = dpotrf(s, lower=1, clean=1)
    inverse: Array
    inverse, _ = dtrtri(factor, lower=1, overwrite_c=1)
    return inverse
