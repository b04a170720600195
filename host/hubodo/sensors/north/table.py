"""Turntables, simulated and on a serial line, and the closed loop that seeks east on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError, LinkError
from hubodo.sensors.north.circle import summarise, wrap
from hubodo.sensors.north.find import horizontal_rate
from hubodo.sensors.north.ml import Averages, estimate
from hubodo.sensors.north.stops import TableMotion

Array = NDArray[np.float64]

PARTS = 4


class Turntable(Protocol):
    """Turns the gyro about the vertical; angles in rad anticlockwise seen from above."""

    def turn_to(self, angle: float) -> None:
        """Return once the table stands still at this angle."""


Measure = Callable[[float], tuple[Array, Array]]
"""Called with s; returns t (N,) s, on one clock from call to call, and the axis's rate (N,) rad/s."""


@dataclass(frozen=True)
class EastStep:
    """One maytag of the closed loop: where the table stood, rad, and the component found there, rad/s."""

    angle: float
    rate: float


@dataclass(frozen=True)
class East:
    """Where the loop came to rest: angle of the axis that points east, rad; azimuth of table zero and its
    sigma from all stops together, rad; every step."""

    angle: float
    azimuth: float
    sigma: float
    steps: tuple[EastStep, ...]


def seek_east(
    table: Turntable,
    measure: Measure,
    latitude: float,
    *,
    start: float = 0.0,
    stop: float = 34.0,
    steps: int = 10,
) -> East:
    """Turn the axis until it reads no Earth rate between both ways round, then make sure that it is not west.

    Each step maytags once (here, about, here again). The first two, a quarter turn apart, say roughly where
    east is; from there the table turns by arcsin(rate / horizontal), less and less as steps add up, so that
    noise is averaged as in stochastic approximation. West is the loop's other zero: the last maytag, a
    quarter turn on, must read north. Raises InputError for fewer than 4 steps.
    """
    if steps < 4:
        raise InputError(f"{steps} steps cannot close the loop; give 4 or more")
    horizontal = horizontal_rate(latitude)
    angle, history = start, []
    rows: list[tuple[float, float, float, float, float]] = []

    def maytag(at: float) -> float:
        means = []
        for way in (0.0, math.pi, 0.0):
            table.turn_to(at + way)
            t, rate = measure(stop)
            means.append(float(rate.mean()))
            step = float(np.median(np.diff(t)))
            for part in np.array_split(np.arange(len(t)), PARTS):
                rows.append(
                    (
                        t[part[0]],
                        t[part[-1]] + step,
                        rate[part].mean(),
                        math.cos(at + way),
                        math.sin(at + way),
                    )
                )
        component = (means[0] - 2 * means[1] + means[2]) / 4
        history.append(EastStep(at, component))
        return component

    along, across = maytag(angle), maytag(angle + math.pi / 2)
    angle += math.atan2(across, along) - math.pi / 2
    for k in range(steps - 3):
        component = maytag(angle)
        angle -= math.asin(max(-1.0, min(1.0, component / horizontal))) / (k + 2)
    if maytag(angle + math.pi / 2) < 0:
        angle += math.pi
    posterior = estimate(Averages(*np.array(rows).T), horizontal)
    azimuth, sigma, _ = summarise(posterior)
    return East(float(wrap(angle)), azimuth, sigma, tuple(history))


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

    def turn_to(self, angle: float) -> None:
        """Turn at the table's speed."""
        self.position += round(abs(angle - self.angle) / self.turn / self.dt)
        self.angle = angle

    def measure(self, duration: float) -> tuple[Array, Array]:
        """The next `duration` s. Raises InputError when the record is used up."""
        count = round(duration / self.dt)
        if self.position + count > len(self.error):
            raise InputError(
                f"the record of {len(self.error) * self.dt:.0f} s is too short for the programme; use fewer "
                f"or "
                "shorter stops"
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


class TablePort(Protocol):
    """The part of `serial.Serial` that is needed."""

    def write(self, data: bytes) -> int | None: ...

    def readline(self) -> bytes: ...


class SerialTable:
    """A table on a serial line that speaks lines of ASCII, 115200 baud, one answer to each command.

    `GOTO <degrees>` turns anticlockwise seen from above, by the shortest way only if the table's slip rings
    allow, and is answered by `OK <degrees>` once it stands still; `ANGLE?` by `ANGLE <degrees>`; trouble by
    `ERR <words>`.
    """

    def __init__(self, port: TablePort) -> None:
        self._port = port

    def turn_to(self, angle: float) -> None:
        """Raises LinkError when the table answers with an error, not at all, or stops more than 0.1 degrees
        off."""
        wanted = math.degrees(angle)
        reached = self._ask(f"GOTO {wanted:.4f}", "OK")
        if abs(math.degrees(float(wrap(math.radians(reached - wanted))))) > 0.1:
            raise LinkError(
                f"the table stopped at {reached:.3f} degrees instead of {wanted:.3f}; check its drive"
            )

    def angle(self) -> float:
        """rad."""
        return math.radians(self._ask("ANGLE?", "ANGLE"))

    def _ask(self, command: str, expected: str) -> float:
        self._port.write(command.encode() + b"\n")
        line = self._port.readline()
        word, _, rest = line.decode("ascii", "replace").strip().partition(" ")
        try:
            if word == expected:
                return float(rest)
        except ValueError:
            pass
        answer = "nothing" if not line else repr(line.decode("ascii", "replace").strip())
        raise LinkError(
            f"the table answered {answer} to {command!r}, expected {expected} and degrees; check port and "
            f"baud"
        )
