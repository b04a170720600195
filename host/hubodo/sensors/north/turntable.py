"""Turntables for a node that is being recorded: one on a serial line, and one turned by hand.

A table on a serial line uses ASCII lines, 115200 baud, with one answer per command. Degrees grow
anticlockwise seen from above and are not wrapped:

    TABLE?          TABLE 1 <name>            identification and protocol version
    LIMITS?         LIMITS <lowest> <highest> or LIMITS NONE for a table with slip rings
    POS?            POS <degrees> IDLE        or POS <degrees> BUSY while turning
    GOTO <degrees>  OK                        starts turning; commands are answered meanwhile
    STOP            OK                        brakes

Any command may be answered with `ERR <words>`: ERR BUSY, ERR LIMIT, or a message of the drive; STOP is
then sent.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from typing import Protocol

from hubodo.errors import InputError, LinkError

TABLE_PROTOCOL_VERSION = 1
ANGLE_TOLERANCE_DEG = 0.1
"""Largest deviation from the commanded angle, degrees."""
TABLE_STUCK_S = 20.0
"""Time after which a busy table that does not move counts as stuck, s."""
TABLE_POLL_S = 0.05
MISS_CONFIRMATIONS = 5
"""Number of position queries before a wrong angle is reported, because a late answer may be outdated."""
MAX_TABLE_TRIES = 3
"""Attempts per command if answers are lost or garbled.

GOTO can be repeated, because its angle is absolute.
"""


class Turntable(Protocol):
    """A table that turns the gyro about the vertical; angles in rad, anticlockwise seen from above."""

    def turn_to(self, angle: float) -> float:
        """Turn to an angle, modulo full turns, wait until the table stops, and return the angle reached."""


class TablePort(Protocol):
    """The part of the interface of `serial.Serial` that is used."""

    def write(self, data: bytes) -> int | None: ...

    def readline(self) -> bytes: ...

    def reset_input_buffer(self) -> None: ...


class SerialTable:
    """A turntable on a serial line.

    The constructor queries identification and limits, and raises LinkError if the device is not such a table.
    """

    def __init__(self, port: TablePort, wait: Callable[[float], None] = time.sleep) -> None:
        self._port, self._wait = port, wait
        version = self._send("TABLE?", "TABLE").split(" ")[0]
        if version != str(TABLE_PROTOCOL_VERSION):
            raise LinkError(
                f"the table uses protocol version {version or '?'}, supported is {TABLE_PROTOCOL_VERSION}"
            )
        limits = self._send("LIMITS?", "LIMITS").split(" ")
        self.limits = None if limits == ["NONE"] else (_degrees(limits[0]), _degrees(limits[-1]))

    def turn_to(self, angle: float) -> float:
        """Turn to an angle, rad, modulo full turns, and return the angle reached.

        Raises LinkError if the table reports an error, does not answer, is stuck or misses the angle;
        InputError if its limits exclude the angle.
        """
        start_angle, is_busy = self._query_position()
        if is_busy:
            start_angle = self._wait_until_stopped(start_angle)
        target = self._nearest_allowed(math.degrees(angle), start_angle)
        try:
            self._send(f"GOTO {target:.4f}", "OK")
            reached = self._wait_until_stopped(start_angle)
            for _ in range(MISS_CONFIRMATIONS):
                # A late answer may be the position before the command.
                if abs(reached - target) <= ANGLE_TOLERANCE_DEG:
                    break
                self._wait(TABLE_POLL_S)
                reached = self._wait_until_stopped(reached)
        except BaseException:
            # After any error nothing supervises the table any more, so it must stop.
            with contextlib.suppress(LinkError):
                self._send("STOP", "OK")
            raise
        if abs(reached - target) > ANGLE_TOLERANCE_DEG:
            raise LinkError(
                f"the table stopped at {reached:.3f} degrees instead of {target:.3f}; check its drive"
            )
        return math.radians(reached)

    def _nearest_allowed(self, target: float, now: float) -> float:
        """Return the equivalent of angle `wanted`, degrees, that is closest to `now` within the limits."""
        nearest = target + 360.0 * round((now - target) / 360.0)
        equivalents = sorted(
            (nearest + 360.0 * k for k in (-1, 0, 1)),
            key=lambda equivalent: (round(abs(equivalent - now), 2), abs(equivalent - target)),
        )
        if self.limits is None:
            return equivalents[0]
        low, high = self.limits
        allowed = [equivalent for equivalent in equivalents if low - 1e-6 <= equivalent <= high + 1e-6]
        if not allowed:
            raise InputError(
                f"the table turns from {low:g} to {high:g} degrees and cannot reach {target % 360:.1f}; "
                "extend its limits, or use a method with fewer directions"
            )
        return allowed[0]

    def _wait_until_stopped(self, start_angle: float) -> float:
        """Wait until the table stops and return its angle, degrees."""
        last_position, stuck_time = start_angle, 0.0
        while True:
            position, is_busy = self._query_position()
            if not is_busy:
                return position
            stuck_time = 0.0 if abs(position - last_position) > 1e-3 else stuck_time + TABLE_POLL_S
            if stuck_time > TABLE_STUCK_S:
                raise LinkError(
                    f"the table is busy but has stood at {position:.3f} degrees for {TABLE_STUCK_S:.0f} s"
                )
            last_position = position
            self._wait(TABLE_POLL_S)

    def _query_position(self) -> tuple[float, bool]:
        position, _, state = self._send("POS?", "POS").partition(" ")
        if state not in ("IDLE", "BUSY"):
            raise LinkError(f"the table answered 'POS {position} {state}' to POS?; expected IDLE or BUSY")
        return _degrees(position), state == "BUSY"

    def _send(self, command: str, expected: str) -> str:
        """Send a command and return the part of the answer after the expected word."""
        answer = "nothing"
        for _ in range(MAX_TABLE_TRIES):
            self._port.reset_input_buffer()
            self._port.write(command.encode() + b"\n")
            line = self._port.readline()
            text = line.decode("ascii", "replace").strip()
            word, _, arguments = text.partition(" ")
            if word == expected:
                return arguments
            answer = repr(text) if line else "nothing"
            if word == "ERR":
                break
        raise LinkError(
            f"the table answered {answer} to {command!r}, expected {expected}; check port and baud"
        )


def _degrees(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise LinkError(f"the table answered {text!r} where degrees were expected") from None


class ManualTable:
    """A table with an angle scale, which the user turns on request.

    ask: shows a line and returns once the user has answered; raises EOFError if nobody can answer.
    """

    def __init__(self, ask: Callable[[str], object]) -> None:
        self._ask = ask
        self._at = 0.0

    def turn_to(self, angle: float) -> float:
        """Ask the user to turn the table to an angle, rad; raise InputError if nobody can answer."""
        rotation = math.degrees(angle - self._at)
        equivalent = "anticlockwise" if rotation > 0 else "clockwise"
        turn = f"by {abs(rotation):.1f}° {equivalent} seen from above, " if abs(rotation) > 0.05 else ""
        try:
            self._ask(
                f"turn the table {turn}to {math.degrees(angle) % 360:.1f}° on its scale (which grows "
                "anticlockwise), take your hands off, then press Enter: "
            )
        except EOFError:
            raise InputError(
                "Enter cannot be pressed, because the input is closed; run it in a terminal, or use "
                "--table PORT"
            ) from None
        self._at = angle
        return angle
