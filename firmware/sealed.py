"""A message authentication code on every packet of a link: without the key no samples, no requests.

A session begins with an opening of the node, 0xFE 0x21 nonce tag, which the host answers with 0xFD 0x22
nonce challenge tag; the node proves its key with 0xFE 0x23 nonce challenge tag. The session key is derived
from nonce and challenge, so that packets of earlier sessions are invalid. Then both send 0xFF session-id
counter frames tag, the host first. protocol/README.md has the bytes. Each tag allocates on the heap.
"""

import os
import struct
from hashlib import sha256
from time import ticks_add, ticks_diff, ticks_ms

from micropython import const
from packets import PacketLink

_FROM_NODE = const(0xFE)
_FROM_HOST = const(0xFD)
_DATA = const(0xFF)
_OPENING = const(0x21)
_ANSWER = const(0x22)
_PROOF = const(0x23)
_ID = const(4)
_NONCE = const(8)
_TAG = const(8)
_SEALED_HEADER_BYTES = const(9)
_NONCES_END = const(26)
_ANSWER_SIZE = const(34)
_MAX_PACKET = const(272)
_SEAL_BYTES = const(17)
_HMAC_BLOCK = const(64)
_NODE_REPLAY_WINDOW = const(16)
_MAX_COUNT = const(1 << 29)
"""Packets per session; then a new session begins."""
_REOPEN_MS = const(2500)
_STRANGER_MS = const(12500)
"""A connection without a valid packet for this time is ended; a new one _REOPEN_MS earlier."""


TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any


class Hmac:
    """HMAC-SHA256 (RFC 2104) with one key of up to 64 bytes."""

    def __init__(self, key):
        self._inner = bytes((key[i] if i < len(key) else 0) ^ 0x36 for i in range(_HMAC_BLOCK))
        self._outer = bytes((key[i] if i < len(key) else 0) ^ 0x5C for i in range(_HMAC_BLOCK))

    def digest(self, *parts):
        """Return the 32 bytes over the concatenation of all parts."""
        inner = sha256(self._inner)
        for part in parts:
            inner.update(part)
        outer = sha256(self._outer)
        outer.update(inner.digest())
        return outer.digest()


class Session:
    """One session key, from nonce and challenge; packets are numbered, those of the host from 1."""

    def __init__(self, key):
        self.hmac = Hmac(key)
        self.id = self.hmac.digest(b"id")[:_ID]
        self.count = self._newest = self._window = 0

    def authenticates(self, view, end):
        """Return True when the tag behind view[:end] is the host's, for a number that is new."""
        tag = self.hmac.digest(b"h", view[1 + _ID : end])
        return _same(tag, view, end) and self._fresh(struct.unpack_from("<I", view, 1 + _ID)[0])

    def _fresh(self, count):
        """Return True when this number is new; packets may arrive out of order within the replay window."""
        ahead = count - self._newest
        if ahead > 0:
            self._window = (
                (self._window << ahead | 1) & ((1 << _NODE_REPLAY_WINDOW) - 1)
                if ahead < _NODE_REPLAY_WINDOW
                else 1
            )
            self._newest = count
            return True
        bit = 1 << -ahead if -ahead < _NODE_REPLAY_WINDOW else 0
        if not bit or self._window & bit:
            return False
        self._window |= bit
        return True


class SealedLink(PacketLink):
    """A sealed link over a carrier; frames wait for a session, invalid packets count as damaged."""

    def __init__(self, carrier, key):
        super().__init__(_MAX_PACKET)
        self._carrier = carrier
        try:
            key = bytes.fromhex(key)
        except ValueError:
            # A random key: better silent than unprotected where a key was intended.
            key = _random() * 4
        self._hmac = Hmac(key)
        self._session: Any = None
        self._next: Any = None
        """Session proven to the host but not used by it yet; until then the previous one stays valid."""
        self._opening: Any = None
        self._out = bytearray(_MAX_PACKET)
        self._out_view = memoryview(self._out)
        self._raw_view = memoryview(self._raw)
        self._connections = carrier.connections
        self._expire()

    def _expire(self):
        """Make a new session due."""
        self._received_ms = ticks_add(ticks_ms(), -_REOPEN_MS)

    def _has_session(self):
        """Return True if there is a session of the present connection."""
        if self._connections != self._carrier.connections:
            self._connections = self._carrier.connections
            self._session = self._next = self._opening = None
            self._expire()
        return self._session is not None

    def step(self):
        carrier = self._carrier
        carrier.step()
        self._has_session()
        if not carrier.is_open():
            self._expire()
            return
        silent_ms = ticks_diff(ticks_ms(), self._received_ms)
        if silent_ms >= _STRANGER_MS:
            carrier.drop()
            self._expire()
        elif silent_ms >= _REOPEN_MS:
            if self._opening is None:
                nonce = _random()
                tag = self._hmac.digest(b"opening", nonce)[:_TAG]
                self._opening = bytes((_FROM_NODE, _OPENING)) + nonce + tag
            # Repeated in a second, also where the carrier does not accept it.
            carrier.send_packet(self._opening, 0, len(self._opening))

    def close(self):
        self._carrier.close()

    def is_open(self):
        return self._has_session() and self._carrier.is_open()

    def _accept(self, raw, at, size):
        if not self._has_session():
            if self._opening is None and self._carrier.is_open():
                # At once, without waiting for the next second.
                self.step()
            return 0
        if not self._carrier.can_send():
            return 0
        session = self._session
        room = self._carrier.packet_bytes - _SEAL_BYTES
        if size > room:
            size = room
        if size <= 0:
            return 0
        out = self._out
        out[0] = _DATA
        out[1 : 1 + _ID] = session.id
        struct.pack_into("<I", out, 1 + _ID, session.count)
        end = _SEALED_HEADER_BYTES + size
        self._out_view[_SEALED_HEADER_BYTES:end] = memoryview(raw)[at : at + size]
        out[end : end + _TAG] = session.hmac.digest(b"n", self._out_view[1 + _ID : end])[:_TAG]
        if not self._carrier.send_packet(out, 0, end + _TAG):
            return 0
        session.count += 1
        if session.count >= _MAX_COUNT:
            self._session = None
            self._expire()
        return size

    def receive_packet(self, raw):
        """Receive a packet into `_raw`; set `_at` to the start of its frames and return their end."""
        size = self._carrier.receive_packet(raw)
        if not size:
            return 0
        kind = raw[0]
        if kind == _DATA and size >= _SEALED_HEADER_BYTES + _TAG:
            session = self._named_session()
            if session is not None and session.authenticates(self._raw_view, size - _TAG):
                self._received_ms = ticks_ms()
                if session is self._next:
                    self._session = session
                    self._next = self._opening = None
                self._at = _SEALED_HEADER_BYTES
                return size - _TAG
        elif kind == _FROM_HOST and size == _ANSWER_SIZE and self._handle_answer():
            return 0
        self.reader.damaged += 1
        return 0

    def _named_session(self):
        """Return the session that the packet in `_raw` names, or None."""
        ident = bytes(self._raw_view[1 : 1 + _ID])
        if self._next is not None and ident == self._next.id:
            return self._next
        if self._session is not None and ident == self._session.id:
            return self._session
        return None

    def _handle_answer(self):
        """Prove the key to a host that has proven it; return True when it has."""
        view = self._raw_view
        if view[1] != _ANSWER or self._opening is None:
            return False
        nonces = bytes(view[2:_NONCES_END])
        if nonces[:_NONCE] != self._opening[2 : 2 + _NONCE]:
            return False
        if not _same(self._hmac.digest(b"answer", nonces), view, _NONCES_END):
            return False
        self._next = Session(self._hmac.digest(b"session", nonces))
        proof = bytes((_FROM_NODE, _PROOF)) + nonces + self._next.hmac.digest(b"proof")[:_TAG]
        self._carrier.send_packet(proof, 0, len(proof))
        return True


def _same(tag, view, at):
    """Return True if view[at:] begins with the tag; in constant time."""
    different = 0
    for i in range(_TAG):
        different |= tag[i] ^ view[at + i]
    return not different


def _random():
    try:
        return os.urandom(_NONCE)
    except AttributeError:
        # For a port without os.urandom.
        import random

        return bytes(random.getrandbits(8) for _ in range(_NONCE))
