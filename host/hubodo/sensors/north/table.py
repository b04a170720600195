"""Turntables under a node that is recorded: one on a serial line, and one that a person turns."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from hubodo.errors import InputError, LinkError
from hubodo.sensors.north.circle import wrap


class Turntable(Protocol):
    """Turns the gyro about the vertical; angles in rad anticlockwise seen from above."""

    def turn_to(self, angle: float) -> None:
        """Return once the table stands still at this angle."""


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
        """Raises LinkError when the table answers with an error or not at all, or misses by 0.1 degrees."""
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


class HandTable:
    """A table with a scale that somebody turns when asked to.

    ask: shows a line and returns when it was answered; EOFError where nobody can.
    """

    def __init__(self, ask: Callable[[str], object]) -> None:
        self._ask = ask
        self._at = 0.0

    def turn_to(self, angle: float) -> None:
        """Raises InputError where nobody can answer."""
        by = math.degrees(angle - self._at)
        way = "anticlockwise" if by > 0 else "clockwise"
        turn = f"by {abs(by):.1f}° {way} seen from above, " if abs(by) > 0.05 else ""
        try:
            self._ask(
                f"turn the table {turn}to {math.degrees(angle) % 360:.1f}° on its scale (which grows "
                "anticlockwise), take your hands off, then press Enter: "
            )
        except EOFError:
            raise InputError(
                "nobody can press Enter, as the input is closed; run it in a terminal, or give --table PORT"
            ) from None
        self._at = angle
