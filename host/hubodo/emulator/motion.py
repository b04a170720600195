"""What a sensor is moved through: the true motion, asked at any chip time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY


@runtime_checkable
class Motion(Protocol):
    """True motion of one node in node axes, t in seconds since the node's power-on.

    Each method takes `t: (n,)` s, in any order and at any spacing, and must be a pure function of it.
    """

    @property
    def duration(self) -> float:
        """Seconds for which the motion is defined; beyond it the last value holds."""
        ...

    def angular_rate(self, t: Array) -> Array:
        """(n, 3) rad/s."""
        ...

    def specific_force(self, t: Array) -> Array:
        """(n, 3) m/s^2."""
        ...

    def temperature(self, t: Array) -> Array:
        """(n,) degC of the sensor."""
        ...

    def magnetic_field(self, t: Array) -> Array:
        """(n, 3) T."""
        ...


def _interpolated(t: Array, grid: Array, columns: Array) -> Array:
    return np.stack([np.interp(t, grid, column) for column in columns.T], axis=1)


@dataclass(frozen=True)
class StillMotion:
    """A node that does not move: constant rate (zero), gravity, temperature and field."""

    duration: float = float("inf")
    rate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    force: tuple[float, float, float] = (0.0, 0.0, STANDARD_GRAVITY)
    degrees: float = 25.0
    field_tesla: tuple[float, float, float] = (20e-6, 0.0, -40e-6)

    def angular_rate(self, t: Array) -> Array:
        """(n, 3) rad/s, the same for every t."""
        return np.tile(np.asarray(self.rate, dtype=np.float64), (len(t), 1))

    def specific_force(self, t: Array) -> Array:
        """(n, 3) m/s^2, the same for every t."""
        return np.tile(np.asarray(self.force, dtype=np.float64), (len(t), 1))

    def temperature(self, t: Array) -> Array:
        """(n,) degC, the same for every t."""
        return np.full(len(t), self.degrees)

    def magnetic_field(self, t: Array) -> Array:
        """(n, 3) T, the same for every t."""
        return np.tile(np.asarray(self.field_tesla, dtype=np.float64), (len(t), 1))


@dataclass(frozen=True)
class RecordedMotion:
    """A recording played back: linear between its samples, its first and last values outside.

    Args:
        t: (n,) s, strictly increasing; the recording's first sample is at `start` of chip time.
        gyro: (n, 3) rad/s.
        accel: (n, 3) m/s^2.
        temperature_c: (n,) degC or one number.
        field_tesla: (n, 3) T or one vector.
        start: s of chip time at which the recording begins; before it the first sample holds.

    Raises:
        ValueError: arrays of different length, or t that does not increase.
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
                f"t {t.shape}, gyro {gyro.shape}, accel {accel.shape}: want (n,), (n, 3), (n, 3)"
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
        """(n, 3) rad/s."""
        return _interpolated(t, self._grid, self.gyro)

    def specific_force(self, t: Array) -> Array:
        """(n, 3) m/s^2."""
        return _interpolated(t, self._grid, self.accel)

    def temperature(self, t: Array) -> Array:
        """(n,) degC."""
        return np.interp(t, self._grid, self._temperature)

    def magnetic_field(self, t: Array) -> Array:
        """(n, 3) T."""
        return _interpolated(t, self._grid, self._field)
