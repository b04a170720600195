"""Decoding of the raw bytes that one link delivered, as a log holds them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hubodo.ingest.link.ports import PortName
from hubodo.ingest.node.bulk import BulkDecoder
from hubodo.ingest.node.log_times import LogTimeSequence
from hubodo.ingest.node.naming import RecordedNames
from hubodo.ingest.node.node_frames import group_by_node
from hubodo.ingest.node.session import NodeSession
from hubodo.log.log_writer import LogWriter
from hubowire import FrameDecoder, PayloadError, decode
from hubowire.messages import Hello

_MAX_PENDING_PIECES = 20_000
_MAX_PENDING_REQUESTS = 16


class LinkRedecoder:
    """The pieces of one link, decoded in portions.

    A portion ends where the link was lost, before and after a new boot of a node, and at the maximum number
    of open clock requests of a node's session.
    """

    def __init__(
        self,
        label: str,
        port: PortName | None,
        target: LogWriter,
        names: RecordedNames,
        known: dict[tuple[str, int, bytes], NodeSession],
    ) -> None:
        """Start without pieces; known: sessions of all senders by link, node id and serial."""
        self.is_open = True
        self.sessions: dict[int, NodeSession] = {}
        self._label, self._target, self._names, self._sessions_by_serial = label, target, names, known
        self._serials: dict[int, bytes] = {}
        self._wanted_name = port.name if port is not None else None
        self._datagrams = port is not None and port.kind == "udp"
        self._decoder = BulkDecoder()
        self._hello_decoder = FrameDecoder()
        self._boots: dict[int, int] = {}
        self._pieces: list[bytes] = []
        self._times: list[int] = []
        self._damage_flags: list[bool] = []
        self._clock_requests: list[tuple[bytes, int]] = []
        self._damaged_count = self._disconnections = self.last_ns = 0

    def add_piece(self, piece: bytes, t_ns: int, *, is_damaged: bool) -> None:
        """Add the bytes up to a delimiter."""
        is_new_boot = (
            not is_damaged and len(piece) > 2 and piece[1] == Hello.type_id and self._is_new_boot(piece)
        )
        if is_new_boot:
            self.decode_pending()
        self._pieces.append(piece if piece.endswith(b"\0") else piece + b"\0")
        self._times.append(t_ns)
        self._damage_flags.append(is_damaged)
        if is_new_boot or len(self._pieces) >= _MAX_PENDING_PIECES:
            self.decode_pending()

    def add_clock_request(self, token: bytes, t_ns: int) -> None:
        """Add a clock request."""
        self._clock_requests.append((token, t_ns))
        if len(self._clock_requests) >= _MAX_PENDING_REQUESTS:
            self.decode_pending()

    def note_host_suspension(self, start_ns: int, end_ns: int) -> None:
        """Note a suspension of the host between these host times."""
        self.decode_pending()
        for session in self.sessions.values():
            session.decoder.note_host_suspension(start_ns, end_ns)

    def handle_lost(self) -> None:
        """Handle the loss of the link, if it was open."""
        self.decode_pending()
        self._disconnections += self.is_open
        self.is_open = False

    def _is_new_boot(self, piece: bytes) -> bool:
        frame = self._hello_decoder.decode_frame(piece.removesuffix(b"\0"))
        try:
            hello = decode(frame.type_id, frame.payload) if frame is not None else None
        except PayloadError:
            return False
        if frame is None or not isinstance(hello, Hello):
            return False
        before = self._boots.get(frame.node)
        self._boots[frame.node] = hello.boot_id
        self._serials[frame.node] = hello.serial
        return before != hello.boot_id

    def decode_pending(self, *, is_final: bool = False) -> None:
        """Decode the pending pieces; as when recording, those of an unknown sender wait for its Hello."""
        awaits_hello = self._datagrams and not self._serials and len(self._pieces) < _MAX_PENDING_PIECES
        if not self._pieces or (awaits_hello and not is_final):
            return
        ends = np.cumsum([len(piece) for piece in self._pieces]) + self._decoder.bytes_in
        times, damaged = np.array(self._times), np.cumsum(self._damage_flags) + self._damaged_count

        def arrival(end: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
            rows = np.searchsorted(ends, end)
            return times[rows], damaged[rows]

        frames_by_node = group_by_node(self._decoder.feed(b"".join(self._pieces)), arrival)
        for node_id in frames_by_node:
            if node_id not in self.sessions:
                self.sessions[node_id] = self._get_or_create_session(node_id)
        for token, t_ns in self._clock_requests:
            for session in self.sessions.values():
                session.add_clock_request(token, t_ns)
        self.last_ns, self._damaged_count = int(times[-1]), int(damaged[-1])
        for node_id, frames in frames_by_node.items():
            self.sessions[node_id].handle_frames(frames, self._disconnections)
        for session in self.sessions.values():
            _ = list(session.resolve_gaps(self.last_ns))
        self._pieces, self._times, self._damage_flags, self._clock_requests = [], [], [], []

    def _get_or_create_session(self, node_id: int) -> NodeSession:
        key = (self._label, node_id, self._serials.get(node_id, b""))
        if not self._datagrams or not key[2]:
            return self._create_session(node_id)
        if key not in self._sessions_by_serial:
            self._sessions_by_serial[key] = self._create_session(node_id)
        return self._sessions_by_serial[key]

    def _create_session(self, node_id: int) -> NodeSession:
        return NodeSession(
            self._names.assign(self._wanted_name, node_id, self._serials.get(node_id, b"")),
            self._label,
            node_id,
            lambda question: False,
            self._target,
            lambda: self.last_ns,
            datagrams=self._datagrams,
            clock_period=1.0,
            order=LogTimeSequence(),
        )
