"""True motion of a sensor as a function of chip time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY


@runtime_checkable
class Motion(Protocol):
    """True motion of one node in node axes; t is in s since power-on of the node.

    Each method takes `t: (n,)` s, in any order and spacing, and is a pure function of it.
    """

    @property
    def duration(self) -> float:
        """Seconds for which the motion is defined; afterwards the last value holds."""
        ...

    def angular_rate(self, t: Array) -> Array:
        """Return the angular rate, (n, 3) rad/s."""
        ...

    def specific_force(self, t: Array) -> Array:
        """Return the specific force, (n, 3) m/s²."""
        ...

    def temperature(self, t: Array) -> Array:
        """Return the temperature of the sensor, (n,) °C."""
        ...

    def magnetic_field(self, t: Array) -> Array:
        """Return the magnetic field, (n, 3) T."""
        ...


def _interpolated(t: Array, grid: Array, columns: Array) -> Array:
    """Interpolate columns linearly at t, (n, columns)."""
    return np.stack([np.interp(t, grid, column) for column in columns.T], axis=1)


@dataclass(frozen=True)
class StillMotion:
    """A node with constant rate, force, temperature and magnetic field; by default at standstill."""

    duration: float = float("inf")
    rate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    force: tuple[float, float, float] = (0.0, 0.0, STANDARD_GRAVITY)
    degrees: float = 25.0
    field_tesla: tuple[float, float, float] = (20e-6, 0.0, -40e-6)

    def angular_rate(self, t: Array) -> Array:
        """Return the constant angular rate, (n, 3) rad/s."""
        return np.tile(np.asarray(self.rate, dtype=np.float64), (len(t), 1))

    def specific_force(self, t: Array) -> Array:
        """Return the constant specific force, (n, 3) m/s²."""
        return np.tile(np.asarray(self.force, dtype=np.float64), (len(t), 1))

    def temperature(self, t: Array) -> Array:
        """Return the constant temperature, (n,) °C."""
        return np.full(len(t), self.degrees)

    def magnetic_field(self, t: Array) -> Array:
        """Return the constant magnetic field, (n, 3) T."""
        return np.tile(np.asarray(self.field_tesla, dtype=np.float64), (len(t), 1))


@dataclass(frozen=True)
class RecordedMotion:
    """Playback of a recording: linear between samples, constant before the first and after the last.

    Attributes
    ----------
    t : (n,) s, strictly increasing.
    gyro : (n, 3) rad/s.
    accel : (n, 3) m/s².
    temperature_c : (n,) °C, or one number.
    field_tesla : (n, 3) T, or one vector.
    start : s of chip time of the first sample.

    Raises
    ------
    ValueError
        If the arrays differ in length, or t does not increase.
    """

    t: Array
    gyro: Array
    accel: Array
    temperature_c: ArrayLike = 25.0
    field_tesla: ArrayLike = (20e-6, 0.0, -40e-6)
    start: float = 0.0
    _grid: Array = field(init=False, repr=False, compare=False)
    _temperature: Array = field(init=False, repr=False, compare=False)
    _field: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        t = np.asarray(self.t, dtype=np.float64)
        gyro, accel = np.asarray(self.gyro, dtype=np.float64), np.asarray(self.accel, dtype=np.float64)
        if t.ndim != 1 or len(t) == 0 or gyro.shape != (len(t), 3) or accel.shape != (len(t), 3):
            raise ValueError(
                f"t {t.shape}, gyro {gyro.shape}, accel {accel.shape}: must be (n,), (n, 3), (n, 3)"
            )
        if np.any(np.diff(t) <= 0):
            raise ValueError(f"t does not increase at sample {int(np.argmax(np.diff(t) <= 0)) + 1}")
        for name, value in (
            ("t", t),
            ("gyro", gyro),
            ("accel", accel),
            ("_grid", t - t[0] + self.start),
            (
                "_temperature",
                np.broadcast_to(np.asarray(self.temperature_c, dtype=np.float64), t.shape).copy(),
            ),
            ("_field", np.broadcast_to(np.asarray(self.field_tesla, dtype=np.float64), gyro.shape).copy()),
        ):
            object.__setattr__(self, name, value)

    @property
    def duration(self) -> float:
        """Chip time of the last sample, s."""
        return float(self._grid[-1])

    def angular_rate(self, t: Array) -> Array:
        """Return the interpolated angular rate, (n, 3) rad/s."""
        return _interpolated(t, self._grid, self.gyro)

    def specific_force(self, t: Array) -> Array:
        """Return the interpolated specific force, (n, 3) m/s²."""
        return _interpolated(t, self._grid, self.accel)

    def temperature(self, t: Array) -> Array:
        """Return the interpolated temperature, (n,) °C."""
        return np.interp(t, self._grid, self._temperature)

    def magnetic_field(self, t: Array) -> Array:
        """Return the interpolated magnetic field, (n, 3) T."""
        return _interpolated(t, self._grid, self._field)
