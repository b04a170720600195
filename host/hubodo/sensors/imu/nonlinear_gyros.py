"""Asymmetry, cubic terms and temperature of gyro scales, tested in the turns between standstills.

With the rate y that a linear gyro would read, it reads y + k |y| (a scale that depends on the direction),
y + k y³, or y + k y T with the temperature T about the mean of the turns. Such a term moves gravity after a
turn by an amount that scale and cross-axis terms do not explain, if turns differ in direction, speed or
temperature.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.sensors.imu.nonlinear_terms import select_terms
from hubodo.sensors.imu.turn_calibration import TurnCalibration, calibrate_from_turns
from hubodo.sensors.imu.turns import Turns, propagate_gravity, turn_errors

_FAMILIES = (1, 3)
_TEMPERATURE = 0
"""Family of the scales that follow the temperature."""
_FAMILY_NAMES = {1: "asymmetry", 3: "cubic"}
_SLOPE_STEP = 1e-4
"""Change of the rate at 1 rad/s by which a derivative is computed."""
_ITERATIONS = 3


def calibrate_with_terms(turns: Turns, bias_sigma: Array) -> tuple[Turns, TurnCalibration, tuple[str, ...]]:
    """Return the turns without significant nonlinear terms, their calibration, and a line for each family.

    bias_sigma: (3,) rad/s. Raises CalibrationError like `calibrate_from_turns`.
    """
    plain = calibrate_from_turns(turns, bias_sigma)
    if not plain.is_observable.all():
        return turns, plain, ()
    used = turns.select(plain.used)

    def fit(families: tuple[int, ...]) -> tuple[TurnCalibration, float, float]:
        trial = _with_slopes(used, families, plain)
        calibration = calibrate_from_turns(trial, bias_sigma)
        # Turns that the trial rejects count as well, so that no family wins by rejecting them.
        others = np.append(calibration.earth_rate, calibration.terms)
        error = turn_errors(trial, calibration.matrix, calibration.bias_change, others)
        return calibration, float((error**2).sum()), 2.0 * len(error) - 12 - trial.slopes.shape[2]

    candidates = _FAMILIES if turns.temperature is None else (_TEMPERATURE, *_FAMILIES)
    calibration, families = select_terms(fit, candidates)
    if not families:
        return turns, plain, ()
    k = np.zeros(3 * len(families))
    for _ in range(_ITERATIONS):
        k = k + calibration.terms
        linear = _with_slopes(_remove_terms(turns, families, k), families, calibration)
        calibration = calibrate_from_turns(linear, bias_sigma)
    values, sigma = (k + calibration.terms).reshape(-1, 3), calibration.term_sigma.reshape(-1, 3)
    if families[0] == _TEMPERATURE:
        mean = float(turns.temperature.mean()) if turns.temperature is not None else 0.0
        calibration = replace(
            calibration, scale_per_degree=values[0], scale_per_degree_sigma=sigma[0], mean_temperature=mean
        )
        families, values, sigma = families[1:], values[1:], sigma[1:]
    return linear, calibration, _describe(families, values, sigma)


def _shape(family: int, rate: Array, turns: Turns) -> Array:
    """Return what a term of a family multiplies at rates (T, L, 3)."""
    if family == _TEMPERATURE and turns.temperature is not None:
        return np.asarray(rate * _warmth(turns)[:, None, None])
    return np.abs(rate) if family == 1 else rate**3


def _warmth(turns: Turns) -> Array:
    """Return the temperatures of the turns about their mean, (T,) °C."""
    temperature = np.zeros(len(turns.dt)) if turns.temperature is None else turns.temperature
    return np.asarray(temperature - temperature.mean())


def _remove_terms(turns: Turns, families: tuple[int, ...], k: Array) -> Turns:
    """Return the turns with rates y of y + sum of k_n shape_n(y). k: by family, then axis."""
    rate = turns.rate
    for _ in range(_ITERATIONS):
        terms = zip(families, k.reshape(-1, 3), strict=True)
        rate = turns.rate - sum((row * _shape(n, rate, turns) for n, row in terms), np.zeros(3))
    return replace(turns, rate=rate)


def _with_slopes(turns: Turns, families: tuple[int, ...], calibration: TurnCalibration) -> Turns:
    """Return the turns with the derivatives of their misclosures by the terms of these families."""
    if not families:
        return turns
    matrix, change = calibration.matrix, calibration.bias_change
    end = propagate_gravity(turns, matrix, change)
    slopes = []
    for family in families:
        for axis in np.eye(3):
            rate = turns.rate - _SLOPE_STEP * axis * _shape(family, turns.rate, turns)
            changed = propagate_gravity(replace(turns, rate=rate), matrix, change)
            slopes.append((end - changed) / _SLOPE_STEP)
    return replace(turns, term_slopes=np.stack(slopes, axis=2))


def _describe(families: tuple[int, ...], k: Array, sigma: Array) -> tuple[str, ...]:
    lines = []
    for family, row, row_sigma in zip(families, k, sigma, strict=True):
        values = ", ".join(
            f"{axis} {100 * v:+.2g} ± {100 * s:.1g} %"
            for axis, v, s in zip("xyz", row, row_sigma, strict=True)
        )
        meaning = "half the difference of the scales of both directions" if family == 1 else "at 1 rad/s"
        lines.append(
            f"the gyros are nonlinear: {_FAMILY_NAMES[family]} {values} ({meaning}); scale and cross-axis "
            "terms are estimated beside it, but the calibration file lacks it"
        )
    return tuple(lines)
