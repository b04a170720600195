"""MicroPython's raw prompt on a serial port: pieces of Python run on a board, all in one conversation.

What is said there: docs.micropython.org/en/latest/reference/repl.html, raw mode.
"""

from __future__ import annotations

import time
from collections.abc import Iterable

import serial

from hubodo.errors import HubodoError

WANTED = b"\x06"
"""What a piece of Python prints when it wants to be sent the next bytes."""
_READY = b"raw REPL; CTRL-B to exit\r\n>"
_SILENCE_S = 60.0
"""The longest that a board may work without a word."""
_AT_ONCE, _PAUSE_S = 256, 0.01
"""Bytes of code, and the pause behind them: a UART has no more room, and nothing tells when it is full."""


class FlashError(HubodoError):
    """The board did not answer, or does not hold what was sent."""


class BoardGone(FlashError):
    """The port went away while something was done on the board."""


class RawPrompt:
    """A board that runs what it is told; `link`, whose time-out is short, is given back by `close`.

    All may raise FlashError, and what pyserial raises of a port that goes away.
    """

    def __init__(self, link: serial.Serial) -> None:
        self._link = link
        self._heard = b""

    def enter(self, patience: float) -> bool:
        """Whether the board has come to its raw prompt; it is interrupted in what it does."""
        self._link.write(b"\r\x03\x01")
        end = time.monotonic() + patience
        while _READY not in self._heard and time.monotonic() < end:
            self._heard += self._link.read(self._link.in_waiting or 1)
        found = _READY in self._heard
        self._heard = b""
        return found

    def run(self, code: str, pieces: Iterable[bytes] = ()) -> str:
        """What `code` prints; each WANTED in it is answered with the next of `pieces`.

        Raises FlashError with the last line of an exception.
        """
        self.begin(code)
        printed, raised = self._until(b"\x04", pieces), self._until(b"\x04")
        self._until(b">")
        if raised:
            raise FlashError(f"{self._link.port}: {raised.decode(errors='replace').strip().splitlines()[-1]}")
        return printed.decode(errors="replace")

    def begin(self, code: str) -> None:
        """Has the board begin with `code`, whose end is not waited for."""
        text = code.encode()
        for at in range(0, len(text), _AT_ONCE):
            if at:
                time.sleep(_PAUSE_S)
            self._link.write(text[at : at + _AT_ONCE])
        self._link.write(b"\x04")
        self._until(b"OK")

    def leave(self) -> None:
        """Back to the prompt that people use."""
        self._link.write(b"\r\x02")

    def close(self) -> None:
        """Gives the port back."""
        self._link.close()

    def _until(self, end: bytes, pieces: Iterable[bytes] = ()) -> bytes:
        wanting, answered = iter(pieces), 0
        limit = time.monotonic() + _SILENCE_S
        while end not in self._heard:
            if self._heard.count(WANTED) > answered:
                self._link.write(next(wanting))
                answered += 1
            more = self._link.read(self._link.in_waiting or 1)
            if more:
                self._heard += more
                limit = time.monotonic() + _SILENCE_S
            elif time.monotonic() > limit:
                raise FlashError(f"{self._link.port}: no answer within {_SILENCE_S:.0f} s; flash again")
        said, _, self._heard = self._heard.partition(end)
        return said
