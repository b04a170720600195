"""An IMU carried from pose to pose while its temperature changes: biases and scales follow it.

Nothing of hubodo is used. The temperature of the chip lags behind its reference profile only where hysteresis
is asked for.
"""

from dataclasses import dataclass

import numpy as np

from generators.poses import carry

PROFILES = {
    "up and down": lambda share: 25.0 + 15.0 * np.sin(2.0 * np.pi * share),
    "two cycles, 30 to 50 °C": lambda share: 40.0 + 10.0 * np.sin(4.0 * np.pi * share),
    "ramp": lambda share: 22.0 + 20.0 * share,
    "constant": lambda share: 31.0 + 0.3 * np.sin(6.0 * share),
}


@dataclass(frozen=True)
class Warmth:
    """Polynomials (order, 3) of the biases about 25 °C, and changes of the scales (3,), 1/°C."""

    gyro: np.ndarray
    accel: np.ndarray
    gyro_scale: np.ndarray
    accel_scale: np.ndarray


def draw_warmth(rng, order, scales=True):
    """Return coefficients of usual MEMS sensors: 0.02 deg/s and 0.5 mg a degree, 100 ppm a degree."""
    sizes = np.array([1.0, 0.03, 1e-3])[:order, None]
    size = 1e-4 if scales else 0.0
    return Warmth(
        np.radians(0.02) * sizes * rng.standard_normal((order, 3)),
        5e-3 * sizes * rng.standard_normal((order, 3)),
        size * rng.standard_normal(3),
        size * rng.standard_normal(3),
    )


def polynomial(coefficients, warmth):
    """Return the sum of coefficients (order, 3) times powers of a temperature difference (N,), (N, 3)."""
    return sum((np.outer(warmth ** (n + 1), row) for n, row in enumerate(coefficients)), np.zeros(3))


def carry_warm(rng, gyro, accel, warmth, profile, *, hysteresis=0.0, **options):
    """Return (t, gyro, accel, temperature) of a record; hysteresis: deg/s between warming and cooling."""
    data = carry(rng, gyro, accel, **options)
    share = data.t / data.t[-1]
    temperature = PROFILES[profile](share)
    difference = temperature - 25.0
    side = 0.5 * np.radians(hysteresis) * np.sign(np.gradient(temperature))
    shown_gyro = data.gyro + polynomial(warmth.gyro, difference) + side[:, None]
    shown_gyro = shown_gyro + difference[:, None] * warmth.gyro_scale * data.true_rate
    shown_accel = data.accel + polynomial(warmth.accel, difference)
    shown_accel = shown_accel + difference[:, None] * warmth.accel_scale * data.true_force
    return data.t, shown_gyro, shown_accel, temperature + 0.02 * rng.standard_normal(len(data.t))
