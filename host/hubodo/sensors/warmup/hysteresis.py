"""Hysteresis of the bias: its difference at one temperature between warming and cooling."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from hubodo.arrays import Array

_PARTS = 40
"""Parts of a record; correlated noise is averaged within a part."""
_MIN_LEG_PARTS = 5
_MAX_P_VALUE = 0.01


@dataclass(frozen=True)
class Hysteresis:
    """The bias while the temperature rises minus that while it falls.

    Attributes:
        difference, sigma: rad/s.
    """

    difference: float
    sigma: float

    @property
    def size(self) -> float:
        """Return the magnitude, rad/s."""
        return abs(self.difference)

    def describe(self) -> str:
        """Return a remark for the user."""
        return (
            f"hysteresis: at one temperature the bias differs by {math.degrees(self.difference):+.2g} ± "
            f"{math.degrees(self.sigma):.1g} deg/s between warming and cooling; the sigma of the bias "
            "includes half of it"
        )


def find_hysteresis(t: Array, temperature: Array, residual: Array, order: int) -> Hysteresis | None:
    """Return the hysteresis in the residual (M,), rad/s, of a model with the temperature, if significant.

    t, temperature: (M,) s and °C. order: of the polynomial that was fitted; it is fitted again beside the
    direction, since it takes up a part of a loop.
    """
    parts = np.array_split(np.arange(len(t)), _PARTS)
    if len(t) < 4 * _PARTS:
        return None
    times, degrees, y = (np.array([values[p].mean() for p in parts]) for values in (t, temperature, residual))
    direction = np.sign(np.gradient(degrees, times))
    if min(np.count_nonzero(direction > 0), np.count_nonzero(direction < 0)) < _MIN_LEG_PARTS:
        return None
    scaled = (degrees - degrees.mean()) / max(float(np.ptp(degrees)), 1e-9)
    design = np.column_stack([scaled[:, None] ** np.arange(order + 1), direction])
    solution = np.linalg.lstsq(design, y, rcond=None)[0]
    left = y - design @ solution
    dof = _PARTS - design.shape[1]
    # Neighbouring parts share slow noise, which leaves fewer independent ones.
    correlation = float(np.clip(left[1:] @ left[:-1] / max(float(left @ left), 1e-300), 0.0, 0.9))
    dof_left = max(dof * (1.0 - correlation) / (1.0 + correlation), 2.0)
    variance = float(left @ left) / dof * np.linalg.inv(design.T @ design)[-1, -1] * dof / dof_left
    sigma = 2.0 * math.sqrt(variance)
    difference = 2.0 * float(solution[-1])
    p_value = 2.0 * float(stdtr(dof_left, -abs(difference) / max(sigma, 1e-300)))
    return Hysteresis(difference, sigma) if p_value < _MAX_P_VALUE else None
