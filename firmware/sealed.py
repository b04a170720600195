"""UDP of which every datagram is proven by a key: who has none can neither send samples nor give orders.

A session begins with a knock of the node, 0xFE key-id nonce, which the host answers with 0xFD key-id nonce
host-nonce tag; its key is made of both nonces, so that nothing of an earlier session counts. Then both send
0xFF key-id counter frames tag. protocol/README.md has the bytes. Each tag takes memory from the heap.
"""

import os
import struct
from hashlib import sha256
from time import ticks_add, ticks_diff, ticks_ms

from link import _write
from micropython import const
from wifi import UdpLink

_KNOCK = const(0xFE)
_WELCOME = const(0xFD)
_DATA = const(0xFF)
_ID = const(4)
_NONCE = const(8)
_TAG = const(8)
_HEAD = const(9)
_WELCOME_SIZE = const(29)
_MOST = const(272)
_BLOCK = const(64)
_WINDOW = const(16)
_LAST = const(1 << 29)
"""Of the counter: then a new session begins."""
_SILENT_MS = const(2500)


TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any


class Hmac:
    """HMAC-SHA256 (RFC 2104) with one key of up to 64 bytes."""

    def __init__(self, key):
        self._inner = bytes((key[i] if i < len(key) else 0) ^ 0x36 for i in range(_BLOCK))
        self._outer = bytes((key[i] if i < len(key) else 0) ^ 0x5C for i in range(_BLOCK))

    def digest(self, *parts):
        """The 32 bytes over all parts, one behind the other."""
        inner = sha256(self._inner)
        for part in parts:
            inner.update(part)
        outer = sha256(self._outer)
        outer.update(inner.digest())
        return outer.digest()


class SealedUdpLink(UdpLink):
    """Frames wait until the host has answered a knock; what comes without a true tag counts as damaged."""

    def __init__(self, settings):
        try:
            key = bytes.fromhex(settings["key"])
        except ValueError:
            # Nobody has this one: better silent than without a key where one was meant.
            key = _random() * 4
        self._hmac = Hmac(key)
        self._id = sha256(b"hubodo key" + key).digest()[:_ID]
        self._session: Any = None
        self._nonce: Any = None
        self._out = bytearray(_MOST)
        self._out_view = memoryview(self._out)
        self._count = self._newest = self._seen = 0
        self._heard_ms = ticks_add(ticks_ms(), -_SILENT_MS)
        super().__init__(settings)
        self._raw = bytearray(_MOST)
        self._raw_view = memoryview(self._raw)

    def turn(self):
        super().turn()
        if self._socket is not None and ticks_diff(ticks_ms(), self._heard_ms) >= _SILENT_MS:
            self._knock()

    def _knock(self):
        if self._nonce is None:
            self._nonce = _random()
        out = self._out
        out[0] = _KNOCK
        out[1 : 1 + _ID] = self._id
        out[1 + _ID : 1 + _ID + _NONCE] = self._nonce
        try:
            _write(self._socket, out, 0, 1 + _ID + _NONCE)
        except OSError:
            # As with frames: again in a second.
            pass

    def _take(self, raw, at, size):
        if self._session is None:
            return 0
        out = self._out
        out[0] = _DATA
        out[1 : 1 + _ID] = self._id
        struct.pack_into("<I", out, 1 + _ID, self._count)
        end = _HEAD + size
        self._out_view[_HEAD:end] = memoryview(raw)[at : at + size]
        out[end : end + _TAG] = self._session.digest(b"n", self._out_view[1 + _ID : end])[:_TAG]
        if not super()._take(out, 0, end + _TAG):
            return 0
        self._count += 1
        if self._count >= _LAST:
            self._session = None
            self._heard_ms = ticks_add(ticks_ms(), -_SILENT_MS)
        return size

    def _received(self, size):
        """Which part of the datagram in `_raw` are frames: (from, to)."""
        raw = self._raw
        if size >= _HEAD + _TAG and bytes(self._raw_view[1 : 1 + _ID]) == self._id:
            if raw[0] == _DATA and self._session is not None:
                if self._proven(size):
                    self._heard_ms = ticks_ms()
                    return _HEAD, size - _TAG
            elif raw[0] == _WELCOME and size == _WELCOME_SIZE and self._nonce is not None:
                if self._welcomed():
                    return 0, 0
        self.reader.damaged += 1
        return 0, 0

    def _proven(self, size):
        view, end = self._raw_view, size - _TAG
        tag = self._session.digest(b"h", view[1 + _ID : end])
        return _same(tag, view, end) and self._fresh(struct.unpack_from("<I", view, 1 + _ID)[0])

    def _fresh(self, count):
        """Whether this number comes for the first time; datagrams may overtake each other by some."""
        ahead = count - self._newest
        if ahead > 0:
            self._seen = (self._seen << ahead | 1) & ((1 << _WINDOW) - 1) if ahead < _WINDOW else 1
            self._newest = count
            return True
        bit = 1 << -ahead if -ahead < _WINDOW else 0
        if not bit or self._seen & bit:
            return False
        self._seen |= bit
        return True

    def _welcomed(self):
        view = self._raw_view
        nonces = bytes(view[1 + _ID : 1 + _ID + 2 * _NONCE])
        if nonces[:_NONCE] != self._nonce:
            return False
        if not _same(self._hmac.digest(b"welcome", nonces), view, 1 + _ID + 2 * _NONCE):
            return False
        self._session = Hmac(self._hmac.digest(b"session", nonces))
        # The host begins to count at 1.
        self._count = self._newest = self._seen = 0
        self._nonce = None
        self._heard_ms = ticks_ms()
        return True


def _same(tag, view, at):
    """Whether view[at:] begins with the tag; takes as long whether it does or not."""
    different = 0
    for i in range(_TAG):
        different |= tag[i] ^ view[at + i]
    return not different


def _random():
    try:
        return os.urandom(_NONCE)
    except AttributeError:
        # Of a port without a source of its own.
        import random

        return bytes(random.getrandbits(8) for _ in range(_NONCE))
