"""A record at rest as the error of a gyro on a turntable that does not exist."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.find import horizontal_rate
from hubodo.sensors.north.stops import TableMotion


@dataclass
class SimulatedTable:
    """A table under a gyro whose error is a given record, played once from its beginning.

    error: (N,) rad/s with `dt` s between. azimuth: rad, of table zero. turn: rad/s, speed of the table,
    during which the record runs on.
    """

    error: Array
    dt: float
    azimuth: float
    latitude: float
    turn: float = math.pi / 2
    angle: float = 0.0
    position: int = 0

    def turn_to(self, angle: float) -> float:
        """Turn at the table's speed."""
        self.position += round(abs(angle - self.angle) / self.turn / self.dt)
        self.angle = angle
        return angle

    def measure(self, duration: float) -> tuple[Array, Array]:
        """The next `duration` s. Raises InputError when the record is used up."""
        count = round(duration / self.dt)
        if self.position + count > len(self.error):
            raise InputError(
                f"the record of {len(self.error) * self.dt:.0f} s is too short for the programme; use fewer "
                "or shorter stops"
            )
        index = np.arange(self.position, self.position + count)
        self.position += count
        earth = horizontal_rate(self.latitude) * math.cos(self.azimuth - self.angle)
        return np.asarray(index * self.dt), self.error[index] + earth


def simulate_stops(table: SimulatedTable, angles: Array, stop: float) -> tuple[Array, Array, TableMotion]:
    """(t, rate, table) of one recording with a stop at each angle: what a log of a real table would hold."""
    at_t: list[float] = []
    at_angle: list[float] = []
    moving: list[bool] = []
    times: list[Array] = []
    rates: list[Array] = []
    for angle in angles:
        if times:
            at_t.append(times[-1][-1] + table.dt)
            at_angle.append(table.angle)
            moving.append(True)
        table.turn_to(float(angle))
        t, rate = table.measure(stop)
        at_t.append(float(t[0]))
        at_angle.append(table.angle)
        moving.append(False)
        times.append(t)
        rates.append(rate)
    at_t.append(float(times[-1][-1]))
    at_angle.append(table.angle)
    moving.append(False)
    return (
        np.concatenate(times),
        np.concatenate(rates),
        TableMotion(np.array(at_t), np.array(at_angle), np.array(moving)),
    )
