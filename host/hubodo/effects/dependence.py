"""What an effect may depend on that takes more than a word: functions of a chain, (N,) each."""

from __future__ import annotations

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Chain

# (m/s)²: at a crawl a path may bend as it likes, and no steering follows.
_CRAWL = 0.25


def temperature_rate(chain: Chain) -> Array:
    """°C per second, as smooth as the thermometer asks for."""
    # Half a second of loading that only this needs: every command that knows effects would wait for it.
    from hubodo.smoothing_spline import fit_smoothing_spline

    edges = np.unique(np.searchsorted(chain.t, np.arange(chain.t[0], chain.t[-1], 0.5)))
    if len(edges) < 20:
        return np.zeros_like(chain.t)
    count = np.diff(edges, append=len(chain.t))
    middle = np.add.reduceat(chain.t, edges) / count
    return fit_smoothing_spline(middle, np.add.reduceat(chain.temperature, edges) / count)(chain.t, 1)


def steering_rate(chain: Chain) -> Array:
    """1/(m s): how fast the curvature of the path changes, d/dt (r v / (v² + c)), nothing at rest."""
    v, r = np.asarray(chain.speed), np.asarray(chain.yaw_rate)
    slower = v**2 + _CRAWL
    turned = (chain.yaw_acceleration * v + r * chain.acceleration) / slower
    return np.asarray(turned - 2.0 * r * v**2 * chain.acceleration / slower**2)


def pulse(angle: Array | float, width: float) -> Array:
    """A bell of height 1 and `width` rad, one sigma, once per turn where the angle, rad, is zero."""
    off = (np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi
    return np.asarray(np.exp(-0.5 * (off / width) ** 2))
