"""Turntables under a node that is recorded: one on a serial line, and one that a person turns.

A table on a serial line speaks lines of ASCII, 115200 baud, one answer to each command; degrees grow
anticlockwise seen from above and are not wrapped:

    TABLE?          TABLE 1 <name>            that it is one, and the version of these lines
    LIMITS?         LIMITS <lowest> <highest> or LIMITS NONE, where slip rings let it turn for ever
    POS?            POS <degrees> IDLE        or POS <degrees> BUSY while it turns
    GOTO <degrees>  OK                        it has begun to turn; answers while it does
    STOP            OK                        it brakes and then stands

Trouble is `ERR <words>` to any of them: ERR BUSY, ERR LIMIT, or what its drive says; it is then told to stop.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from typing import Protocol

from hubodo.errors import InputError, LinkError

VERSION = 1
REACHED_DEG = 0.1
"""A table that stands further than this from where it was sent has missed."""
STUCK_S = 20.0
"""A table that is busy and has not moved for so long is stuck."""
POLL_S = 0.05
SURE = 5
"""Looks at a table that seems to have missed."""
TRIES = 3
"""A line that is lost or garbled is asked for again; GOTO too, as it names a place and not a step."""


class Turntable(Protocol):
    """Turns the gyro about the vertical; angles in rad anticlockwise seen from above."""

    def turn_to(self, angle: float) -> float:
        """Return once the table stands still, at this angle or whole turns from it: where it stands."""


class TablePort(Protocol):
    """The part of `serial.Serial` that is needed."""

    def write(self, data: bytes) -> int | None: ...

    def readline(self) -> bytes: ...

    def reset_input_buffer(self) -> None: ...


class SerialTable:
    """A table on a serial line, asked at once what it is and how far it may turn.

    Raises LinkError for what is no such table.
    """

    def __init__(self, port: TablePort, wait: Callable[[float], None] = time.sleep) -> None:
        self._port, self._wait = port, wait
        version = self._ask("TABLE?", "TABLE").split(" ")[0]
        if version != str(VERSION):
            raise LinkError(f"the table speaks version {version or '?'} of its lines, this is {VERSION}")
        limits = self._ask("LIMITS?", "LIMITS").split(" ")
        self.limits = None if limits == ["NONE"] else (_degrees(limits[0]), _degrees(limits[-1]))

    def turn_to(self, angle: float) -> float:
        """Raises LinkError when the table reports trouble, does not answer, is stuck or misses the angle.

        InputError where its limits leave no way there.
        """
        begin, busy = self._position()
        if busy:
            begin = self._stand(begin)
        wanted = self._within(math.degrees(angle), begin)
        try:
            self._ask(f"GOTO {wanted:.4f}", "OK")
            reached = self._stand(begin)
            for _ in range(SURE):
                # A late answer may still be of the time before it was sent there.
                if abs(reached - wanted) <= REACHED_DEG:
                    break
                self._wait(POLL_S)
                reached = self._stand(reached)
        except BaseException:
            # Nobody looks after it any more, whatever went wrong: it must not turn on.
            with contextlib.suppress(LinkError):
                self._ask("STOP", "OK")
            raise
        if abs(reached - wanted) > REACHED_DEG:
            raise LinkError(
                f"the table stopped at {reached:.3f} degrees instead of {wanted:.3f}; check its drive"
            )
        return math.radians(reached)

    def _within(self, wanted: float, now: float) -> float:
        """Degrees: the nearest way to look where `wanted` does that the limits allow."""
        nearest = wanted + 360.0 * round((now - wanted) / 360.0)
        ways = sorted(
            (nearest + 360.0 * k for k in (-1, 0, 1)),
            key=lambda way: (round(abs(way - now), 2), abs(way - wanted)),
        )
        if self.limits is None:
            return ways[0]
        low, high = self.limits
        allowed = [way for way in ways if low - 1e-6 <= way <= high + 1e-6]
        if not allowed:
            raise InputError(
                f"the table turns from {low:g} to {high:g} degrees and cannot look to "
                f"{wanted % 360:.1f}; widen its limits, or take a method with fewer directions"
            )
        return allowed[0]

    def _stand(self, begin: float) -> float:
        """Degrees where it comes to rest."""
        last, still = begin, 0.0
        while True:
            at, busy = self._position()
            if not busy:
                return at
            still = 0.0 if abs(at - last) > 1e-3 else still + POLL_S
            if still > STUCK_S:
                raise LinkError(f"the table is busy but has stood at {at:.3f} degrees for {STUCK_S:.0f} s")
            last = at
            self._wait(POLL_S)

    def _position(self) -> tuple[float, bool]:
        at, _, state = self._ask("POS?", "POS").partition(" ")
        if state not in ("IDLE", "BUSY"):
            raise LinkError(f"the table answered 'POS {at} {state}' to POS?; expected IDLE or BUSY")
        return _degrees(at), state == "BUSY"

    def _ask(self, command: str, expected: str) -> str:
        """What follows the expected word."""
        answer = "nothing"
        for _ in range(TRIES):
            self._port.reset_input_buffer()
            self._port.write(command.encode() + b"\n")
            line = self._port.readline()
            text = line.decode("ascii", "replace").strip()
            word, _, rest = text.partition(" ")
            if word == expected:
                return rest
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


class HandTable:
    """A table with a scale that somebody turns when asked to.

    ask: shows a line and returns when it was answered; EOFError where nobody can.
    """

    def __init__(self, ask: Callable[[str], object]) -> None:
        self._ask = ask
        self._at = 0.0

    def turn_to(self, angle: float) -> float:
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
        return angle
