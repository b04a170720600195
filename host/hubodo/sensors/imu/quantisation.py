"""Quantisation of a channel: its step, and the error that averaging over a standstill does not remove.

A quantiser with step L adds an error that depends on the true value. White noise of standard deviation s in
front of it (dither) attenuates the error of the mean; over all true values its variance is
g(s) = sum over k of L² / (2 π² k²) exp(-4 π² k² s² / L²), which is L²/12 without noise (Widrow and Kollár,
Quantization Noise, 2008, chapter 19). The scatter of the samples about their mean then is s² + L²/12 - g(s).
"""

from __future__ import annotations

import math

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY

_MAX_LEVELS = 200_000
_MIN_LEVEL_DIFFERENCES, _MAX_MULTIPLE, _MULTIPLE_TOLERANCE = 8, 100.0, 0.05
_MIN_RECURRENCE = 20
_MAX_DECIMALS, _FEW_LEVELS = 12, 64
_DECIMAL_UNITS = (1.0, STANDARD_GRAVITY, STANDARD_GRAVITY * 1e-3, math.pi / 180.0, math.pi / 648e3)
"""Units in which a file may have been rounded: SI, g, mg, deg/s, deg/h."""
_EPSILON = float(np.finfo(float).eps)
_DITHER = np.linspace(0.0, 1.0, 401)
_HARMONIC = np.arange(1, 200)[:, None]
_MEAN_VARIANCE = (np.exp(-4.0 * np.pi**2 * _HARMONIC**2 * _DITHER**2) / (2.0 * np.pi**2 * _HARMONIC**2)).sum(
    axis=0
)
_SCATTER_VARIANCE = _DITHER**2 + _MEAN_VARIANCE[0] - _MEAN_VARIANCE


def find_quantisation_steps(values: Array) -> Array:
    """Return the quantisation step of each column of values (N, C), 0 where the values lie on no grid."""
    return np.array([_find_step(column) for column in values.T])


def undithered_sigma(scatter: Array, steps: Array) -> Array:
    """Return the standard deviation of a mean due to quantisation, (C,), which no averaging reduces.

    scatter: (C,) standard deviation of the samples about their mean. steps: (C,) quantisation steps.
    """
    safe = np.where(steps > 0.0, steps, 1.0)
    variance = np.interp((scatter / safe) ** 2, _SCATTER_VARIANCE, _MEAN_VARIANCE, right=0.0)
    return np.asarray(np.where(steps > 0.0, steps * np.sqrt(variance), 0.0))


def rounding_sigma(values: Array, step: float | None = None) -> tuple[float, float]:
    """Return the error of means that rounding causes and no averaging reduces (1σ), and the step.

    values: (N,) a channel whose true value changes by less than its noise from one sample to the next. step:
    if known from other values of the channel.
    """
    if step is None:
        step = _find_step(values)
    scatter = float(np.sqrt(np.mean(np.diff(values) ** 2) / 2.0))
    return float(undithered_sigma(np.array([scatter]), np.array([step]))[0]), step


def describe_rounding(step: float, rounding: float) -> str:
    """Return a remark on the steps of a gyro, rad/s, that its noise does not average out."""
    return (
        f"the output has steps of {math.degrees(step):.3g} deg/s, which its noise does not average out: "
        f"sigma includes {math.degrees(rounding) * 3600.0:.3g} °/h for it; use a smaller range"
    )


def _find_step(values: Array) -> float:
    levels = np.unique(values[:: max(1, len(values) // _MAX_LEVELS)])
    largest = float(np.abs(levels).max())
    differences = np.diff(levels)
    differences = differences[differences > 64.0 * _EPSILON * largest]
    if not len(differences):
        return 0.0
    step = _decimal_step(levels)
    multiples = differences / differences.min()
    multiples = multiples[multiples < _MAX_MULTIPLE]
    # A few levels that recur are evidence enough; values that are not rounded hardly recur.
    if (len(multiples) >= _MIN_LEVEL_DIFFERENCES or _MIN_RECURRENCE * len(levels) < len(values)) and np.abs(
        multiples - np.rint(multiples)
    ).max() < _MULTIPLE_TOLERANCE:
        step = max(step, float(differences.min()))
    if step == 0.0 and np.array_equal(levels, levels.astype(np.float32)):
        step = float(np.spacing(np.float32(largest)))
    return step


def _decimal_step(levels: Array) -> float:
    """Return the decimal step to which all levels are rounded in a common unit; 0 if there is none."""
    best, largest = 0.0, float(np.abs(levels).max())
    # Values that are not rounded fail at a few of them already.
    few = levels[:: max(1, len(levels) // _FEW_LEVELS)]
    for unit in _DECIMAL_UNITS:
        for decimals in range(_MAX_DECIMALS + 1):
            step = unit * 10.0**-decimals
            tolerance = 1e-9 + 8.0 * _EPSILON * (largest / step)
            if tolerance > _MULTIPLE_TOLERANCE:
                break
            if _are_multiples(few, step, tolerance) and _are_multiples(levels, step, tolerance):
                best = max(best, step)
                break
    return best


def _are_multiples(levels: Array, step: float, tolerance: float) -> bool:
    counts = levels / step
    return bool(np.abs(counts - np.rint(counts)).max() < tolerance)
