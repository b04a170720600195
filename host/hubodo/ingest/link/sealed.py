"""Sessions with nodes on UDP, without I/O: datagrams in, what they prove out; see protocol/README.md.

What a session has proven cannot be sent again: its key is made of two nonces, one of the host's own, and each
datagram of it has a number that counts once.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from hubodo.ingest.link.keys import KeyRing

KNOCK, WELCOME, DATA = 0xFE, 0xFD, 0xFF
ID_BYTES, NONCE_BYTES, TAG_BYTES = 4, 8, 8
_HEAD = struct.Struct("<B4sI")
_MOST_OFFERED = 8
_WINDOW = 64


def key_id(key: bytes) -> bytes:
    """By which a datagram says whose it is; nothing of the key can be told from it."""
    return hashlib.sha256(b"hubodo key" + key).digest()[:ID_BYTES]


def _digest(key: bytes, *parts: bytes) -> bytes:
    return hmac.digest(key, b"".join(parts), "sha256")


@dataclass(frozen=True, slots=True)
class Opened:
    """What a datagram brought. serial: of the board that has proven it; answer: what goes back at once."""

    frames: bytes = b""
    serial: str = ""
    answer: bytes = b""


class _Session:
    """One key made of two nonces; both directions count from 1 on, a node from 0."""

    def __init__(self, key: bytes, nonces: bytes) -> None:
        self.key = _digest(key, b"session", nonces)
        self.sent = 0
        self._newest, self._seen = -1, 0

    def proven(self, body: bytes, tag: bytes) -> bool:
        return hmac.compare_digest(_digest(self.key, b"n", body)[:TAG_BYTES], tag)

    def fresh(self, count: int) -> bool:
        """Whether this number comes for the first time, within what may overtake."""
        ahead = count - self._newest
        if ahead > 0:
            self._seen = (self._seen << ahead | 1) & ((1 << _WINDOW) - 1) if ahead < _WINDOW else 1
            self._newest = count
            return True
        if -ahead >= _WINDOW or self._seen >> -ahead & 1:
            return False
        self._seen |= 1 << -ahead
        return True

    def seal(self, ident: bytes, frames: bytes) -> bytes:
        self.sent += 1
        head = _HEAD.pack(DATA, ident, self.sent)
        return head + frames + _digest(self.key, b"h", head[1 + ID_BYTES :], frames)[:TAG_BYTES]


class _Peer:
    """One board: its key, the session that stands, and those that were offered and not taken up yet."""

    def __init__(self, serial: str, key: bytes) -> None:
        self.serial, self.key, self.ident = serial, key, key_id(key)
        self.session: _Session | None = None
        self.offered: list[_Session] = []
        self.address = ""

    def welcome(self, nonce: bytes, drawn: bytes) -> bytes:
        """The answer to a knock; the session begins when the node uses it."""
        nonces = nonce + drawn
        self.offered = [*self.offered[1 - _MOST_OFFERED :], _Session(self.key, nonces)]
        tag = _digest(self.key, b"welcome", nonces)[:TAG_BYTES]
        return bytes([WELCOME]) + self.ident + nonces + tag

    def takes(self, body: bytes, tag: bytes) -> bool | None:
        """Whether the datagram belongs to a session and is new; None when to none."""
        for session in (self.session, *self.offered):
            if session is not None and session.proven(body, tag):
                if session is not self.session:
                    self.session, self.offered = session, []
                return session.fresh(struct.unpack_from("<I", body)[0])
        return None


class Sealer:
    """All sessions behind one port. refused: datagrams that were not let in, by cause."""

    def __init__(self, keys: KeyRing, draw: Callable[[int], bytes] = secrets.token_bytes) -> None:
        self.refused: Counter[str] = Counter()
        self._draw = draw
        self._peers = [_Peer(serial, key) for serial, key in keys.keys.items()]
        self._of: dict[bytes, list[_Peer]] = {}
        for peer in self._peers:
            self._of.setdefault(peer.ident, []).append(peer)

    def open(self, data: bytes, address: str) -> Opened:
        """A datagram that came from an address."""
        kind = data[0] if data else 0
        if kind not in (KNOCK, DATA):
            return self._refuse("without a key")
        peers = self._of.get(data[1 : 1 + ID_BYTES])
        if peers is None:
            return self._refuse("of a key that the file does not hold")
        if kind == KNOCK:
            if len(data) != 1 + ID_BYTES + NONCE_BYTES:
                return self._refuse("malformed")
            return Opened(answer=peers[0].welcome(data[-NONCE_BYTES:], self._draw(NONCE_BYTES)))
        if len(data) < _HEAD.size + TAG_BYTES:
            return self._refuse("malformed")
        body, tag = data[1 + ID_BYTES : -TAG_BYTES], data[-TAG_BYTES:]
        for peer in peers:
            known = peer.takes(body, tag)
            if known is None:
                continue
            if not known:
                return self._refuse("sent again")
            peer.address = address
            return Opened(body[4:], peer.serial)
        # Also what a node sends that has not heard yet that this host was started.
        return self._refuse("of no session")

    def seal(self, frames: bytes, serial: str) -> tuple[bytes, str] | None:
        """The datagram and its address for the board with that serial; None while it has no session."""
        peer = next((peer for peer in self._peers if peer.serial == serial), None)
        if peer is None or peer.session is None:
            return None
        return peer.session.seal(peer.ident, frames), peer.address

    def _refuse(self, why: str) -> Opened:
        self.refused[why] += 1
        return Opened()
