"""MicroPython's raw prompt on a serial port: code is run on a board in one session.

Protocol: docs.micropython.org/en/latest/reference/repl.html, raw mode.
"""

from __future__ import annotations

import time
from collections.abc import Iterable

import serial

from hubodo.errors import HubodoError

NEXT_CHUNK = b"\x06"
"""Printed by a program on the board to request the next bytes."""
_READY = b"raw REPL; CTRL-B to exit\r\n>"
_RESPONSE_TIMEOUT_S = 60.0
"""Longest time in s that a board may work without output."""
_CODE_CHUNK_BYTES, _CHUNK_PAUSE_S = 256, 0.01
"""Size of the chunks of code and the pause after each: a UART buffer holds no more, without flow control."""


class FlashError(HubodoError):
    """The error for a board that does not answer or holds other data than sent."""


class BoardDisconnected(FlashError):
    """The error for a port that disconnected during an operation."""


class RawPrompt:
    """The raw prompt of a board on `link`, which has a short timeout and is closed by `close`.

    All methods may raise FlashError, and the errors of pyserial for a disconnected port.
    """

    def __init__(self, link: serial.Serial) -> None:
        self._link = link
        self._received = b""

    def enter(self, timeout: float) -> bool:
        """Interrupt the board; return True if it is at the raw prompt within `timeout` s."""
        self._link.write(b"\r\x03\x01")
        end = time.monotonic() + timeout
        while _READY not in self._received and time.monotonic() < end:
            self._received += self._link.read(self._link.in_waiting or 1)
        is_ready = _READY in self._received
        self._received = b""
        return is_ready

    def run(self, code: str, pieces: Iterable[bytes] = ()) -> str:
        """Run code and return what it prints; each NEXT_CHUNK in it is answered with the next of `pieces`.

        Raises FlashError with the last line of an exception.
        """
        self.start(code)
        printed, raised = self._read_until(b"\x04", pieces), self._read_until(b"\x04")
        self._read_until(b">")
        if raised:
            raise FlashError(f"{self._link.port}: {raised.decode(errors='replace').strip().splitlines()[-1]}")
        return printed.decode(errors="replace")

    def start(self, code: str) -> None:
        """Start code without waiting for its end."""
        text = code.encode()
        for offset in range(0, len(text), _CODE_CHUNK_BYTES):
            if offset:
                time.sleep(_CHUNK_PAUSE_S)
            self._link.write(text[offset : offset + _CODE_CHUNK_BYTES])
        self._link.write(b"\x04")
        self._read_until(b"OK")

    def leave(self) -> None:
        """Return to the interactive prompt."""
        self._link.write(b"\r\x02")

    def close(self) -> None:
        """Close the port."""
        self._link.close()

    def _read_until(self, end: bytes, pieces: Iterable[bytes] = ()) -> bytes:
        chunks, answered = iter(pieces), 0
        limit = time.monotonic() + _RESPONSE_TIMEOUT_S
        while end not in self._received:
            if self._received.count(NEXT_CHUNK) > answered:
                self._link.write(next(chunks))
                answered += 1
            more = self._link.read(self._link.in_waiting or 1)
            if more:
                self._received += more
                limit = time.monotonic() + _RESPONSE_TIMEOUT_S
            elif time.monotonic() > limit:
                raise FlashError(
                    f"{self._link.port}: no answer within {_RESPONSE_TIMEOUT_S:.0f} s; flash again"
                )
        output, _, self._received = self._received.partition(end)
        return output
