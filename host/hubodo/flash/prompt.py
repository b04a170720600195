"""MicroPython's raw prompt on a serial port: code is run on a board in one session.

Protocol: docs.micropython.org/en/latest/reference/repl.html, raw mode and raw-paste mode.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterable

import serial

from hubodo.errors import HubodoError

NEXT_CHUNK = b"\x06"
"""Printed by a program on the board to request the next bytes."""
_READY = b"raw REPL; CTRL-B to exit\r\n>"
_RESPONSE_TIMEOUT_S = 60.0
"""Longest time in s that a board may work without output."""
_ASK_PASTE, _PASTE_ANSWER = b"\x05A\x01", re.compile(rb"R([\x00\x01])")
_MORE_ROOM, _END = b"\x01", b"\x04"
_CODE_CHUNK_BYTES, _CHUNK_PAUSE_S = 256, 0.01
"""Chunks of code for a board without flow control, and the pause after each: a UART buffer holds no more."""


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
        printed, raised = self._read_until(_END, pieces), self._read_until(_END)
        self._read_until(b">")
        if raised:
            raise FlashError(f"{self._link.port}: {raised.decode(errors='replace').strip().splitlines()[-1]}")
        return printed.decode(errors="replace")

    def start(self, code: str) -> None:
        """Start code without waiting for its end."""
        if self._has_flow_control():
            self._paste(code.encode())
        else:
            self._send_chunks(code.encode())

    def _has_flow_control(self) -> bool:
        """Ask the board; a second banner may come first, as the bytes that stop a node contain ctrl-A."""
        self._link.write(_ASK_PASTE)
        limit = time.monotonic() + _RESPONSE_TIMEOUT_S
        while not (answer := _PASTE_ANSWER.search(self._received)):
            self._read_more(limit)
        self._received = self._received[answer.end() :]
        return answer[1] == b"\x01"

    def _paste(self, text: bytes) -> None:
        """Send code no faster than the board reads it; a board that refuses it prints why afterwards."""
        window = int.from_bytes(self._read_bytes(2), "little")
        room, offset, is_refused = window, 0, False
        while offset < len(text) and not is_refused:
            if room == 0 or self._received or self._link.in_waiting:
                mark = self._read_bytes(1)
                is_refused = mark == _END
                if mark not in (_MORE_ROOM, _END):
                    raise FlashError(f"{self._link.port}: {mark!r} while code was sent; flash again")
                room += window
                continue
            chunk = text[offset : offset + room]
            self._link.write(chunk)
            room, offset = room - len(chunk), offset + len(chunk)
        self._link.write(_END)
        if not is_refused:
            self._read_until(_END)

    def _send_chunks(self, text: bytes) -> None:
        for offset in range(0, len(text), _CODE_CHUNK_BYTES):
            if offset:
                time.sleep(_CHUNK_PAUSE_S)
            self._link.write(text[offset : offset + _CODE_CHUNK_BYTES])
        self._link.write(_END)
        self._read_until(b"OK")

    def leave(self) -> None:
        """Return to the interactive prompt."""
        self._link.write(b"\r\x02")

    def close(self) -> None:
        """Close the port."""
        self._link.close()

    def _read_bytes(self, count: int) -> bytes:
        limit = time.monotonic() + _RESPONSE_TIMEOUT_S
        while len(self._received) < count:
            self._read_more(limit)
        data, self._received = self._received[:count], self._received[count:]
        return data

    def _read_until(self, end: bytes, pieces: Iterable[bytes] = ()) -> bytes:
        chunks, answered = iter(pieces), 0
        limit = time.monotonic() + _RESPONSE_TIMEOUT_S
        while end not in self._received:
            if self._received.count(NEXT_CHUNK) > answered:
                self._link.write(next(chunks))
                answered += 1
            if self._read_more(limit):
                limit = time.monotonic() + _RESPONSE_TIMEOUT_S
        output, _, self._received = self._received.partition(end)
        return output

    def _read_more(self, limit: float) -> bool:
        """Read what the port has; return True for some bytes. Raises FlashError after the time `limit`."""
        more = self._link.read(self._link.in_waiting or 1)
        self._received += more
        if not more and time.monotonic() > limit:
            raise FlashError(f"{self._link.port}: no answer within {_RESPONSE_TIMEOUT_S:.0f} s; flash again")
        return bool(more)
