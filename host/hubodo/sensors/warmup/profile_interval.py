"""Intervals of a warm-up's size and time constant from the profile likelihood, where sigmas are not valid.

Where noise hides the curve, the likelihood of c1 and T is not Gaussian: with a small T the curve ends before
the first means, with a large T it is a straight line. The interval contains every value that the record does
not exclude: 2 (log L_max - log L(value)) <= chi-square quantile, with the other parameters at their best
(Venzon and Moolgavkar, Applied Statistics 37, 1988).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.unit_systems import RATE, RATE_SAMPLE

_CHI_SQUARE_95 = 3.8415
"""Quantile of 95 % of the chi-square distribution of one degree of freedom."""
_TIME_CONSTANTS = 240
"""Time constants of the search, evenly spaced in their logarithm, 4 % apart."""
_MAX_TIME_CONSTANT_PER_SPAN = 30.0
"""Ratio to the record from which a curve is a straight line to a tenth of its bend at three."""


@dataclass(frozen=True)
class ProfileIntervals:
    """95 % intervals of c1 (rad/s) and of the time constant (s); None for an open end."""

    c1: tuple[float | None, float | None]
    time_constant: tuple[float | None, float | None]

    def ends(self, name: str) -> list[float | None]:
        """Return both ends of the interval of a parameter, `c1` or `time_constant`."""
        return list(self.c1 if name == "c1" else self.time_constant)


def profile_intervals(t: Array, means: Array, variance: float) -> ProfileIntervals:
    """Return the intervals for means (N,) rad/s at ages t (N,) s.

    variance: variance of one mean, (rad/s)², including the effect of correlation.
    """
    span = float(t[-1] - t[0])
    shortest = max(2.0 * float(np.median(np.diff(t))), span / 300.0)
    constants = np.geomspace(shortest, _MAX_TIME_CONSTANT_PER_SPAN * span, _TIME_CONSTANTS)
    fractions = -np.expm1(-t / constants[:, None])
    centred = fractions - fractions.mean(axis=1, keepdims=True)
    power = np.einsum("kn,kn->k", centred, centred)
    c1 = centred @ (means - means.mean()) / power
    # Log likelihood of the best c1 and c2 at each time constant, relative to that of a constant bias.
    gain = c1**2 * power / variance
    deficit = gain.max() - gain
    inside = np.flatnonzero(deficit <= _CHI_SQUARE_95)
    margin = np.sqrt(np.maximum(_CHI_SQUARE_95 - deficit[inside], 0.0) * variance / power[inside])
    low, high = float(np.min(c1[inside] - margin)), float(np.max(c1[inside] + margin))
    first, last = int(inside[0]), int(inside[-1])
    # With a time constant far beyond the record the curve is a line, so c1 is unbounded as the time constant
    # is.
    is_line = last == _TIME_CONSTANTS - 1
    return ProfileIntervals(
        (None if is_line and low < 0.0 else low, None if is_line and high > 0.0 else high),
        (
            None if first == 0 else float(constants[first]),
            None if is_line else float(constants[last]),
        ),
    )


def describe_intervals(intervals: ProfileIntervals) -> str:
    """Return the intervals of c1 and time constant as text."""
    unit = RATE.shown(RATE_SAMPLE)
    c1 = _describe_range(intervals.c1, unit.factor, "+.3g", unit.name)
    constant = _describe_range(intervals.time_constant, 1.0 / 60.0, ".3g", "min")
    return f"c1 {c1}, time constant {constant} (95 % intervals)"


def _describe_range(ends: tuple[float | None, float | None], factor: float, form: str, unit: str) -> str:
    low, high = ends
    if low is None:
        return "unbounded" if high is None else f"up to {high * factor:{form}} {unit}"
    if high is None:
        return f"from {low * factor:{form}} {unit} on"
    return f"{low * factor:{form}} to {high * factor:{form}} {unit}"
