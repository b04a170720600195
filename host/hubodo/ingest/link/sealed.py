"""Sessions with nodes on UDP, without I/O: datagrams in, what they prove out; see protocol/README.md.

Nothing is stored for a datagram that has not proven a key. The host's answer to an opening carries a
challenge, made of a secret of this process and of the time, and the node's proof brings it back: a session
begins with the proof, and only a challenge newer than that of the session before counts. An opening or a
proof that somebody recorded and sends again therefore changes nothing.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import struct
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from hubodo.ingest.link.keys import KeyRing

FROM_NODE, FROM_HOST, DATA = 0xFE, 0xFD, 0xFF
OPENING, ANSWER, PROOF = 0x21, 0x22, 0x23
"""Second byte of the handshake: its version, then its step."""
ID_BYTES, NONCE_BYTES, TAG_BYTES = 4, 8, 8
_HEAD = struct.Struct("<B4sI")
_TIME = struct.Struct(">Q")
_CHALLENGE_BYTES = _TIME.size + TAG_BYTES
_OPENING_BYTES = 2 + NONCE_BYTES + TAG_BYTES
_PROOF_BYTES = 2 + NONCE_BYTES + _CHALLENGE_BYTES + TAG_BYTES
_VERSION_1_OPENING_BYTES = 1 + ID_BYTES + NONCE_BYTES
_WINDOW = 64


def _tag(key: bytes, *parts: bytes) -> bytes:
    return _digest(key, *parts)[:TAG_BYTES]


def _digest(key: bytes, *parts: bytes) -> bytes:
    return hmac.digest(key, b"".join(parts), "sha256")


def _version_1_id(key: bytes) -> bytes:
    """Return by which a node of the first handshake, which showed it in clear, said whose it is."""
    return hashlib.sha256(b"hubodo key" + key).digest()[:ID_BYTES]


@dataclass(frozen=True, slots=True)
class Opened:
    """What a datagram brought. serial: of the board that has proven it; answer: what goes back at once."""

    frames: bytes = b""
    serial: str = ""
    answer: bytes = b""


class _Session:
    """One key made of nonce and challenge, and the numbers seen; a node counts from 0, the host from 1."""

    def __init__(self, key: bytes, nonce: bytes, challenge: bytes) -> None:
        self.key = _digest(key, b"session", nonce, challenge)
        self.ident = _digest(self.key, b"id")[:ID_BYTES]
        self.begun = _TIME.unpack_from(challenge)[0]
        self.sent = 0
        self._newest, self._seen = -1, 0

    def proves(self, tag: bytes, *parts: bytes) -> bool:
        return hmac.compare_digest(_tag(self.key, *parts), tag)

    def is_fresh(self, count: int) -> bool:
        """Return True when this number comes for the first time, within what may overtake."""
        ahead = count - self._newest
        if ahead > 0:
            self._seen = (self._seen << ahead | 1) & ((1 << _WINDOW) - 1) if ahead < _WINDOW else 1
            self._newest = count
            return True
        if -ahead >= _WINDOW or self._seen >> -ahead & 1:
            return False
        self._seen |= 1 << -ahead
        return True

    def seal(self, frames: bytes) -> bytes:
        self.sent += 1
        head = _HEAD.pack(DATA, self.ident, self.sent)
        return head + frames + _tag(self.key, b"h", head[1 + ID_BYTES :], frames)


class _Peer:
    """One board: its key, the session in use, and a proven one that the node has not used yet."""

    def __init__(self, serial: str, key: bytes) -> None:
        self.serial, self.key = serial, key
        self.session: _Session | None = None
        self.next: _Session | None = None
        self.address = ""

    @property
    def newest(self) -> int:
        """Time of the newest challenge that this board has proven; -1 before the first."""
        return max(
            (session.begun for session in (self.session, self.next) if session is not None), default=-1
        )


class Sealer:
    """All sessions behind one port. refused: datagrams that were not let in, by cause."""

    def __init__(
        self,
        keys: KeyRing,
        draw: Callable[[int], bytes] = secrets.token_bytes,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """clock: ns, the times in challenges; each is later than the one before."""
        self.refused: Counter[str] = Counter()
        self._secret = draw(32)
        self._clock, self._last = clock, 0
        self._peers = {serial: _Peer(serial, key) for serial, key in keys.keys.items()}
        self._sessions: dict[bytes, tuple[_Peer, _Session]] = {}
        self._version_1 = {_version_1_id(peer.key): serial for serial, peer in self._peers.items()}

    def open(self, data: bytes, address: str) -> Opened:
        """A datagram that came from an address."""
        kind = data[0] if data else 0
        if kind == DATA:
            return self._data(data, address)
        if kind != FROM_NODE:
            return self._refuse("without a key")
        head, nonce, tag = data[:2], data[2 : 2 + NONCE_BYTES], data[-TAG_BYTES:]
        if head == bytes([FROM_NODE, OPENING]) and len(data) == _OPENING_BYTES:
            return self._opening(nonce, tag)
        if head == bytes([FROM_NODE, PROOF]) and len(data) == _PROOF_BYTES:
            return self._proof(nonce, data[2 + NONCE_BYTES : -TAG_BYTES], tag)
        serial = self._version_1.get(data[1 : 1 + ID_BYTES])
        if serial is not None and len(data) == _VERSION_1_OPENING_BYTES:
            return self._refuse(f"of the older handshake of node {serial}: flash it again")
        return self._refuse("malformed")

    def seal(self, frames: bytes, serial: str) -> tuple[bytes, str] | None:
        """The datagram and its address for the board with that serial; None while it has no session."""
        peer = self._peers.get(serial)
        if peer is None or peer.session is None:
            return None
        return peer.session.seal(frames), peer.address

    def _opening(self, nonce: bytes, tag: bytes) -> Opened:
        """Answer what one of the keys has proven, by a challenge; nothing is stored."""
        for peer in self._peers.values():
            if hmac.compare_digest(_tag(peer.key, b"opening", nonce), tag):
                self._last = max(self._clock(), self._last + 1)
                challenge = self._challenge(peer, nonce, _TIME.pack(self._last))
                proof = _tag(peer.key, b"answer", nonce, challenge)
                return Opened(answer=bytes([FROM_HOST, ANSWER]) + nonce + challenge + proof)
        return self._refuse("of a key that the file does not hold")

    def _challenge(self, peer: _Peer, nonce: bytes, at: bytes) -> bytes:
        return at + _tag(self._secret, peer.serial.encode(), nonce, at)

    def _proof(self, nonce: bytes, challenge: bytes, tag: bytes) -> Opened:
        """Begin a session with who has brought a challenge of ours back, sealed with a key."""
        at = challenge[: _TIME.size]
        for peer in self._peers.values():
            if hmac.compare_digest(self._challenge(peer, nonce, at), challenge):
                break
        else:
            return self._refuse("of no session")
        session = _Session(peer.key, nonce, challenge)
        if not session.proves(tag, b"proof"):
            return self._refuse("of a key that the file does not hold")
        if session.begun <= peer.newest:
            return self._refuse("sent again")
        self._forget(peer.next)
        peer.next = session
        self._sessions[session.ident] = peer, session
        return Opened(answer=session.seal(b""))

    def _data(self, data: bytes, address: str) -> Opened:
        if len(data) < _HEAD.size + TAG_BYTES:
            return self._refuse("malformed")
        known = self._sessions.get(data[1 : 1 + ID_BYTES])
        body, tag = data[1 + ID_BYTES : -TAG_BYTES], data[-TAG_BYTES:]
        if known is None or not known[1].proves(tag, b"n", body):
            # Also what a node sends that does not know yet that this host was started.
            return self._refuse("of no session")
        peer, session = known
        if not session.is_fresh(struct.unpack_from("<I", body)[0]):
            return self._refuse("sent again")
        if session is peer.next:
            self._forget(peer.session)
            peer.session, peer.next = session, None
        peer.address = address
        return Opened(body[4:], peer.serial)

    def _forget(self, session: _Session | None) -> None:
        if session is not None:
            self._sessions.pop(session.ident, None)

    def _refuse(self, why: str) -> Opened:
        self.refused[why] += 1
        return Opened()
