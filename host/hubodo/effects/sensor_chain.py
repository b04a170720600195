"""Data that effects read and change: the geometry, and the signals of one node on their way to readings."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hubodo.arrays import Array
from hubodo.vehicle import Side

REFERENCE_CELSIUS = 25.0
"""Temperature in °C at which effects of temperature are zero."""

REFERENCE_VOLTS = 3.7
"""Supply voltage in V at which effects of the supply are zero."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """Geometry of the vehicle and of one wheel, as seen by a node; SI units, angles in rad.

    Attributes
    ----------
    side : side of the wheel; None for a node on the body.
    radius, track_width : m.
    camber : rad, positive when the wheel top leans inwards.
    grade : rad, positive uphill.
    tyre_growth : s²/rad², k in R (1 + k spin²).
    wheel_slip : s²/m, k in spin = v_w / R (1 + k v_w').
    eccentricity : (A cos p, A sin p), with amplitude A relative to the radius and phase p.
    lever_arm : (3,) m, from the axle to the sensing point in node axes.
    reference_y : m, y coordinate in the body at which the speed input was measured.
    """

    side: Side | None
    radius: float
    track_width: float
    camber: float = 0.0
    grade: float = 0.0
    tyre_growth: float = 0.0
    wheel_slip: float = 0.0
    eccentricity: tuple[float, float] = (0.0, 0.0)
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reference_y: float = 0.0


_MOTION_FIELDS = (
    "supply",
    "angle",
    "spin",
    "opposite_spin",
    "speed",
    "acceleration",
    "yaw_rate",
    "yaw_acceleration",
    "heading",
)
"""Fields of a `SensorChain` that hold one value per sample, or one value for all samples."""


@dataclass(slots=True)
class SensorChain:
    """Signals of one node on their way through the sensor chain, for N samples.

    Attributes
    ----------
    t : (N,) s since power-on, or since the start of the log where power-on is unknown.
    temperature : (N,) °C, of the sensor.
    rate, force : (3, N) true angular rate in rad/s and specific force in m/s² at the sensor, in node axes.
    rate_derivative : (3, N) rad/s², time derivative of `rate`.
    gyro, accel : (3, N) readings in rad/s and m/s², which the effects change.
    angle, spin : rad and rad/s, of the node's wheel; 0 for a node on the body.
    opposite_spin : rad/s, spin of the wheel on the other side.
    speed, acceleration : m/s and m/s², of the vehicle.
    yaw_rate, yaw_acceleration, heading : rad/s, rad/s² and rad from the start of the log, of the vehicle.
    facing : +1 where the z axis of the node points left, else -1.
    supply : V.
    terms : columns of empirical terms that were already evaluated for these samples, by expression.
    """

    t: Array
    temperature: Array
    rate: Array
    rate_derivative: Array
    force: Array
    gyro: Array
    accel: Array
    angle: Array | float = 0.0
    spin: Array | float = 0.0
    acceleration: Array | float = 0.0
    yaw_rate: Array | float = 0.0
    facing: float = 1.0
    opposite_spin: Array | float = 0.0
    speed: Array | float = 0.0
    yaw_acceleration: Array | float = 0.0
    heading: Array | float = 0.0
    supply: Array | float = REFERENCE_VOLTS
    terms: dict[str, list[Array]] = field(default_factory=dict)

    def select(self, samples: slice) -> SensorChain:
        """Return the chain of a slice of the samples."""
        selected = replace(self, t=self.t[samples], temperature=self.temperature[samples], terms={})
        for name in ("rate", "rate_derivative", "force", "gyro", "accel"):
            setattr(selected, name, getattr(self, name)[:, samples])
        for name in _MOTION_FIELDS:
            value = getattr(self, name)
            setattr(selected, name, value[samples] if isinstance(value, np.ndarray) else value)
        return selected


@dataclass(frozen=True, slots=True)
class Noise:
    """White sensor noise, 1σ of one sample: `gyro` in rad/s, `accel` in m/s²."""

    gyro: float
    accel: float
