"""Authenticated sessions with nodes on UDP, without I/O; see protocol/README.md.

Nothing is stored for a datagram that is not authenticated by a key. The host answers an opening with a
challenge derived from a secret of this process and the time, and the node returns it in its proof. A session
starts with the proof, and only if its challenge is newer than that of the previous session: a replayed
opening or proof has no effect.
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
"""Second byte of the handshake: version (high nibble) and step (low nibble)."""
ID_BYTES, NONCE_BYTES, TAG_BYTES = 4, 8, 8
_DATA_HEADER = struct.Struct("<B4sI")
_CHALLENGE_TIME = struct.Struct(">Q")
_CHALLENGE_BYTES = _CHALLENGE_TIME.size + TAG_BYTES
_OPENING_BYTES = 2 + NONCE_BYTES + TAG_BYTES
_PROOF_BYTES = 2 + NONCE_BYTES + _CHALLENGE_BYTES + TAG_BYTES
_VERSION_1_OPENING_BYTES = 1 + ID_BYTES + NONCE_BYTES
_REPLAY_WINDOW = 64  # datagrams that may arrive out of order


def _tag(key: bytes, *parts: bytes) -> bytes:
    return _digest(key, *parts)[:TAG_BYTES]


def _digest(key: bytes, *parts: bytes) -> bytes:
    return hmac.digest(key, b"".join(parts), "sha256")


def _version_1_id(key: bytes) -> bytes:
    """Return the key id that a node with the first version of the handshake sends in clear."""
    return hashlib.sha256(b"hubodo key" + key).digest()[:ID_BYTES]


@dataclass(frozen=True, slots=True)
class OpenedDatagram:
    """Contents of a datagram; serial: the authenticated board; answer: the datagram to send back at once."""

    frames: bytes = b""
    serial: str = ""
    answer: bytes = b""


class _Session:
    """A session key derived from nonce and challenge, with the datagram counters of both directions."""

    def __init__(self, key: bytes, nonce: bytes, challenge: bytes) -> None:
        self.key = _digest(key, b"session", nonce, challenge)
        self.session_id = _digest(self.key, b"id")[:ID_BYTES]
        self.challenge_time_ns = _CHALLENGE_TIME.unpack_from(challenge)[0]
        self.sent_count = 0
        self._newest_count, self._received_mask = -1, 0

    def verifies(self, tag: bytes, *parts: bytes) -> bool:
        return hmac.compare_digest(_tag(self.key, *parts), tag)

    def accept_count(self, count: int) -> bool:
        """Return True for the first datagram with this count, unless it is older than the replay window."""
        ahead = count - self._newest_count
        if ahead > 0:
            self._received_mask = (
                (self._received_mask << ahead | 1) & ((1 << _REPLAY_WINDOW) - 1)
                if ahead < _REPLAY_WINDOW
                else 1
            )
            self._newest_count = count
            return True
        if -ahead >= _REPLAY_WINDOW or self._received_mask >> -ahead & 1:
            return False
        self._received_mask |= 1 << -ahead
        return True

    def seal(self, frames: bytes) -> bytes:
        self.sent_count += 1
        head = _DATA_HEADER.pack(DATA, self.session_id, self.sent_count)
        return head + frames + _tag(self.key, b"h", head[1 + ID_BYTES :], frames)


class _Peer:
    """One board: its key, the session in use, and an accepted session that the node has not used yet."""

    def __init__(self, serial: str, key: bytes) -> None:
        self.serial, self.key = serial, key
        self.session: _Session | None = None
        self.next_session: _Session | None = None
        self.address = ""

    @property
    def newest_challenge_ns(self) -> int:
        """Time of the newest challenge that this board has answered, ns; -1 before the first."""
        return max(
            (
                session.challenge_time_ns
                for session in (self.session, self.next_session)
                if session is not None
            ),
            default=-1,
        )


class DatagramSealer:
    """All sessions of one port; refused: number of datagrams not accepted, by cause."""

    def __init__(
        self,
        keys: KeyRing,
        random_bytes: Callable[[int], bytes] = secrets.token_bytes,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Start without sessions; now_ns: monotonic time for challenges; random_bytes: source of secrets."""
        self.refused: Counter[str] = Counter()
        self._secret = random_bytes(32)
        self._now_ns, self._last_challenge_ns = now_ns, 0
        self._peers = {serial: _Peer(serial, key) for serial, key in keys.keys.items()}
        self._sessions: dict[bytes, tuple[_Peer, _Session]] = {}
        self._version_1_serials = {_version_1_id(peer.key): serial for serial, peer in self._peers.items()}

    def open(self, data: bytes, address: str) -> OpenedDatagram:
        """Authenticate a datagram from an address and return its contents."""
        kind = data[0] if data else 0
        if kind == DATA:
            return self._open_data(data, address)
        if kind != FROM_NODE:
            return self._refuse("without a key")
        head, nonce, tag = data[:2], data[2 : 2 + NONCE_BYTES], data[-TAG_BYTES:]
        if head == bytes([FROM_NODE, OPENING]) and len(data) == _OPENING_BYTES:
            return self._answer_opening(nonce, tag)
        if head == bytes([FROM_NODE, PROOF]) and len(data) == _PROOF_BYTES:
            return self._accept_proof(nonce, data[2 + NONCE_BYTES : -TAG_BYTES], tag)
        serial = self._version_1_serials.get(data[1 : 1 + ID_BYTES])
        if serial is not None and len(data) == _VERSION_1_OPENING_BYTES:
            return self._refuse(f"of the older handshake of node {serial}: flash it again")
        return self._refuse("malformed")

    def seal(self, frames: bytes, serial: str) -> tuple[bytes, str] | None:
        """Return the sealed datagram and the address of a board; None while it has no session."""
        peer = self._peers.get(serial)
        if peer is None or peer.session is None:
            return None
        return peer.session.seal(frames), peer.address

    def _answer_opening(self, nonce: bytes, tag: bytes) -> OpenedDatagram:
        """Answer an opening that is authenticated by one of the keys with a challenge; store nothing."""
        for peer in self._peers.values():
            if hmac.compare_digest(_tag(peer.key, b"opening", nonce), tag):
                self._last_challenge_ns = max(self._now_ns(), self._last_challenge_ns + 1)
                challenge = self._make_challenge(peer, nonce, _CHALLENGE_TIME.pack(self._last_challenge_ns))
                proof = _tag(peer.key, b"answer", nonce, challenge)
                return OpenedDatagram(answer=bytes([FROM_HOST, ANSWER]) + nonce + challenge + proof)
        return self._refuse("of a key that the file does not hold")

    def _make_challenge(self, peer: _Peer, nonce: bytes, time_bytes: bytes) -> bytes:
        return time_bytes + _tag(self._secret, peer.serial.encode(), nonce, time_bytes)

    def _accept_proof(self, nonce: bytes, challenge: bytes, tag: bytes) -> OpenedDatagram:
        """Start a session with the node that returned a challenge of this host, authenticated by its key."""
        time_bytes = challenge[: _CHALLENGE_TIME.size]
        for peer in self._peers.values():
            if hmac.compare_digest(self._make_challenge(peer, nonce, time_bytes), challenge):
                break
        else:
            return self._refuse("of no session")
        session = _Session(peer.key, nonce, challenge)
        if not session.verifies(tag, b"proof"):
            return self._refuse("of a key that the file does not hold")
        if session.challenge_time_ns <= peer.newest_challenge_ns:
            return self._refuse("sent again")
        self._remove_session(peer.next_session)
        peer.next_session = session
        self._sessions[session.session_id] = peer, session
        return OpenedDatagram(answer=session.seal(b""))

    def _open_data(self, data: bytes, address: str) -> OpenedDatagram:
        if len(data) < _DATA_HEADER.size + TAG_BYTES:
            return self._refuse("malformed")
        known = self._sessions.get(data[1 : 1 + ID_BYTES])
        body, tag = data[1 + ID_BYTES : -TAG_BYTES], data[-TAG_BYTES:]
        if known is None or not known[1].verifies(tag, b"n", body):
            # This includes datagrams of a node that has not noticed the restart of this host.
            return self._refuse("of no session")
        peer, session = known
        if not session.accept_count(struct.unpack_from("<I", body)[0]):
            return self._refuse("sent again")
        if session is peer.next_session:
            self._remove_session(peer.session)
            peer.session, peer.next_session = session, None
        peer.address = address
        return OpenedDatagram(body[4:], peer.serial)

    def _remove_session(self, session: _Session | None) -> None:
        if session is not None:
            self._sessions.pop(session.session_id, None)

    def _refuse(self, cause: str) -> OpenedDatagram:
        self.refused[cause] += 1
        return OpenedDatagram()
