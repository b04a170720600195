"""Pauses between attempts to open a link, growing until a connection has carried valid data."""

from __future__ import annotations

import re
from functools import reduce
from operator import xor

from hubowire import FrameDecoder

_INITIAL_PAUSE_S = 0.05
_MAX_ABSENT_PAUSE_S = 1.0
"""Maximum pause while the device is absent: a device plugged in again is opened within a second."""
_MAX_USELESS_PAUSE_S = 8.0
"""Maximum pause after connections without a valid frame."""
_MIN_PROVEN_DURATION_NS = 10_000_000_000
_MAX_SEARCHED_BYTES = 65536
_NMEA_SENTENCE = re.compile(rb"\$([^\r\n$*]{5,120})\*([0-9A-Fa-f]{2})")


class ValidityCheck:
    """A search for a valid frame or NMEA sentence in the first 64 kB of a connection."""

    def __init__(self, opened_ns: int) -> None:
        self._opened_ns = opened_ns
        self._is_valid = False
        self._searched_bytes = 0
        self._frames = FrameDecoder()
        self._text = b""

    def feed(self, data: bytes) -> None:
        """Search further bytes; returns at once after the first valid frame."""
        if self._is_valid or self._searched_bytes >= _MAX_SEARCHED_BYTES:
            return
        self._searched_bytes += len(data)
        self._text = (self._text + data)[-2 * _MAX_SEARCHED_BYTES :]
        self._is_valid = bool(self._frames.feed(data)) or any(
            reduce(xor, sentence[1]) == int(sentence[2], 16)
            for sentence in _NMEA_SENTENCE.finditer(self._text)
        )
        self._text = b"" if self._is_valid else self._text[-128:]

    def is_valid(self, now_ns: int) -> bool:
        """Return True after a valid frame or sentence, or once the connection has lasted for 10 s."""
        return self._is_valid or now_ns - self._opened_ns >= _MIN_PROVEN_DURATION_NS


class Backoff:
    """Exponential back-off: pauses in s before the next attempt, doubling from 0.05 s.

    A bridge that accepts and closes, or a port that opens and fails, is retried at most every 8 s.
    """

    def __init__(self) -> None:
        self._failed_opens = 0
        self._useless_connections = 0

    @property
    def is_first(self) -> bool:
        """True until an attempt to open has failed since the last connection."""
        return not self._failed_opens

    def pause_after_failed_open(self) -> float:
        """Return the pause after a failed attempt to open."""
        self._failed_opens += 1
        return _pause_after(self._failed_opens, _MAX_ABSENT_PAUSE_S)

    def pause_after_loss(self, *, was_valid: bool) -> float:
        """Return the pause after a lost connection; was_valid: True if it carried valid data."""
        self._failed_opens = 1
        self._useless_connections = 0 if was_valid else self._useless_connections + 1
        return _pause_after(self._useless_connections, _MAX_USELESS_PAUSE_S)


def _pause_after(failures: int, max_s: float) -> float:
    return min(_INITIAL_PAUSE_S * 2.0 ** min(failures, 16), max_s)
