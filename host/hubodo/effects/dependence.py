"""Derived quantities that effects may depend on: functions of a sensor chain, (N,) each."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.sensor_chain import SensorChain

_CURVATURE_SPEED2 = 0.25  # (m/s)², c in `steering_rate`: keeps the curvature finite near standstill


def temperature_rate(chain: SensorChain) -> Array:
    """Return the derivative of the temperature, °C/s, smoothed according to the noise of the thermometer."""
    # Imported here, because the import takes 0.5 s and every command that uses effects would wait for it.
    from hubodo.smoothing_spline import fit_smoothing_spline

    edges = np.unique(np.searchsorted(chain.t, np.arange(chain.t[0], chain.t[-1], 0.5)))
    if len(edges) < 20:
        return np.zeros_like(chain.t)
    count = np.diff(edges, append=len(chain.t))
    middle = np.add.reduceat(chain.t, edges) / count
    return fit_smoothing_spline(middle, np.add.reduceat(chain.temperature, edges) / count)(chain.t, 1)


def steering_rate(chain: SensorChain) -> Array:
    """Return the rate of change of the path curvature, 1/(m s): d/dt (r v / (v² + c)), zero at standstill.

    v: speed, m/s. r: yaw rate, rad/s. c: `_CURVATURE_SPEED2`.
    """
    v, r = np.asarray(chain.speed), np.asarray(chain.yaw_rate)
    denominator = v**2 + _CURVATURE_SPEED2
    numerator_rate = chain.yaw_acceleration * v + r * chain.acceleration
    return np.asarray(numerator_rate / denominator - 2.0 * r * v**2 * chain.acceleration / denominator**2)


def pulse(angle: Array | float, width: float) -> Array:
    """Return a Gaussian pulse of height 1 and 1σ width `width`, once per turn at angle 0; both in rad."""
    wrapped = (np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(np.exp(-0.5 * (wrapped / width) ** 2))
