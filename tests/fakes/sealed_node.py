"""A node's half of a session on UDP with a key, written from protocol/README.md without code of the host."""

from __future__ import annotations

import hashlib
import hmac
import os
import struct


def tag(key: bytes, *parts: bytes) -> bytes:
    return whole_tag(key, *parts)[:8]


def whole_tag(key: bytes, *parts: bytes) -> bytes:
    return hmac.new(key, b"".join(parts), hashlib.sha256).digest()


class SealedNode:
    """A node's side of a session: datagrams to the host, and decoding of the host's."""

    def __init__(self, key: bytes) -> None:
        self.key = key
        self.nonce = os.urandom(8)
        self.session: bytes | None = None
        self.count = 0
        self._next: bytes | None = None
        self._numbers: set[tuple[bytes, int]] = set()

    def opening(self) -> bytes:
        return b"\xfe\x21" + self.nonce + tag(self.key, b"opening", self.nonce)

    def proof(self, answer: bytes) -> bytes | None:
        """Return the proof for an answer of the host; None if it does not belong to this opening."""
        nonces = answer[2:26]
        if answer[:2] != b"\xfd\x22" or len(answer) != 34 or nonces[:8] != self.nonce:
            return None
        if answer[26:] != tag(self.key, b"answer", nonces):
            return None
        self._next = whole_tag(self.key, b"session", nonces)
        return b"\xfe\x23" + nonces + tag(self._next, b"proof")

    def open(self, data: bytes) -> bytes | None:
        """Return the frames in a datagram of the host; None if it is not authenticated."""
        for session in (self._next, self.session):
            if session is None or data[:5] != b"\xff" + whole_tag(session, b"id")[:4]:
                continue
            number = (session, struct.unpack_from("<I", data, 5)[0])
            if data[-8:] != tag(session, b"h", data[5:-8]) or number in self._numbers:
                return None
            self._numbers.add(number)
            if session is self._next:
                self.session, self._next, self.count, self.nonce = session, None, 0, os.urandom(8)
            return data[9:-8]
        return None

    def seal(self, frames: bytes) -> bytes:
        assert self.session is not None
        body = struct.pack("<I", self.count) + frames
        self.count += 1
        return b"\xff" + whole_tag(self.session, b"id")[:4] + body + tag(self.session, b"n", body)
