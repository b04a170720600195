"""Simulated turntable: a stationary gyro record plus Earth rate at the table's angle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.sensors.north.north_estimate import horizontal_earth_rate
from hubodo.sensors.north.stops import TableMotion


@dataclass
class SimulatedTable:
    """A simulated table with a gyro whose errors are a given record, used once from start to end.

    Attributes:
        gyro_error: (N,) rad/s at intervals of `dt` s.
        azimuth: azimuth of table zero, rad.
        latitude: latitude of the table, rad.
        turn_rate: speed of the table, rad/s; the record continues during turns.
        angle: current table angle, rad.
        position: index of the next sample.
    """

    gyro_error: Array
    dt: float
    azimuth: float
    latitude: float
    turn_rate: float = math.pi / 2
    angle: float = 0.0
    position: int = 0

    def turn_to(self, angle: float) -> float:
        """Turn to an angle, rad, at the table's speed, and return the angle."""
        self.position += round(abs(angle - self.angle) / self.turn_rate / self.dt)
        self.angle = angle
        return angle

    def measure(self, duration: float) -> tuple[Array, Array]:
        """Return times, s, and rates, rad/s, of the next `duration` s.

        Raise InputError at the record's end.
        """
        count = round(duration / self.dt)
        if self.position + count > len(self.gyro_error):
            raise InputError(
                f"the record of {len(self.gyro_error) * self.dt:.0f} s is too short for the programme; use "
                "fewer or shorter stops"
            )
        index = np.arange(self.position, self.position + count)
        self.position += count
        earth = horizontal_earth_rate(self.latitude) * math.cos(self.azimuth - self.angle)
        return np.asarray(index * self.dt), self.gyro_error[index] + earth


def simulate_stops(table: SimulatedTable, angles: Array, stop: float) -> tuple[Array, Array, TableMotion]:
    """Return times, rates and table motion of one recording with a stop of `stop` s at each angle (rad)."""
    row_t: list[float] = []
    row_angle: list[float] = []
    moving: list[bool] = []
    times: list[Array] = []
    rates: list[Array] = []
    for angle in angles:
        if times:
            row_t.append(times[-1][-1] + table.dt)
            row_angle.append(table.angle)
            moving.append(True)
        table.turn_to(float(angle))
        t, rate = table.measure(stop)
        row_t.append(float(t[0]))
        row_angle.append(table.angle)
        moving.append(False)
        times.append(t)
        rates.append(rate)
    row_t.append(float(times[-1][-1]))
    row_angle.append(table.angle)
    moving.append(False)
    return (
        np.concatenate(times),
        np.concatenate(rates),
        TableMotion(np.array(row_t), np.array(row_angle), np.array(moving)),
    )
