"""Identification of the board that sent a frame, by address and serial, with tables of bounded size."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from hubodo.ingest.node.gaps import LinkCounts
from hubowire import Frame
from hubowire.messages import Hello

MAX_NODES = 64
"""Maximum number of nodes on one link; Hellos of further nodes are refused."""
MAX_SENDERS = 256
"""Maximum number of addresses of identified nodes, and separately of unidentified senders."""
_MAX_HELD_FRAMES = 2048  # frames of unidentified senders, about 1 MB
_IDENTIFY_INTERVAL_NS = 500_000_000
_HELLO_HEADER_BYTES = 7
_SERIAL_BYTES = slice(7, 15)
PendingFrame = tuple[Frame, int, LinkCounts]
Sender = tuple[str, int]
"""An address and a node id."""


class Route(NamedTuple):
    """The board a frame belongs to.

    Attributes
    ----------
    board
        Number of the board among those with this node id; None while unidentified or refused.
    frames
        Frames that can be decoded now, in order of arrival.
    should_identify
        True if the sender's Hello is to be requested.
    """

    node_id: int
    board: int | None = None
    frames: Sequence[PendingFrame] = ()
    should_identify: bool = False


@dataclass(slots=True)
class _UnidentifiedSender:
    """A sender whose Hello was not received yet, with its held frames."""

    next_request_ns: int = 0
    frames: list[PendingFrame] = field(default_factory=list)


def read_serial(frame: Frame) -> bytes | None:
    """Return the serial in a Hello; None for other frames, and for a Hello too short for any version."""
    if frame.type_id != Hello.type_id or len(frame.payload) < _HELLO_HEADER_BYTES:
        return None
    return frame.payload[_SERIAL_BYTES]


class SenderTable:
    """The boards on one link and the addresses they send from.

    A board is identified by the serial in its Hello and keeps its number when its address changes, as after a
    restart; frames received before that Hello are held. On a line with one sender the node id alone
    identifies a node. Unidentified senders have a table of their own, from which the least recently received
    is evicted first, so that they never displace an identified board.
    """

    def __init__(self, *, datagrams: bool) -> None:
        self.frames_refused = 0
        """Number of frames of nodes beyond MAX_NODES."""
        self.senders_evicted = 0
        """Number of unidentified senders dropped with their held frames."""
        self._datagrams = datagrams
        self._boards: dict[tuple[int, bytes], int] = {}
        self._board_counts: dict[int, int] = {}
        self._addresses: dict[tuple[int, int], str] = {}
        self._identified: OrderedDict[Sender, int] = OrderedDict()
        self._unidentified: OrderedDict[Sender, _UnidentifiedSender] = OrderedDict()
        self._held_count = 0

    def address(self, node_id: int, board: int) -> str:
        """Return the address from which a board sent last; empty if unknown."""
        return self._addresses.get((node_id, board), "")

    def is_identified(self, sender: str, node_id: int) -> bool:
        """Return True if this address belongs to an identified board."""
        return (sender, node_id) in self._identified

    def route(self, held: PendingFrame, sender: str) -> Route:
        """Return the board of a frame, with the held frames that precede it."""
        frame, t_ns, _ = held
        key = (sender, frame.node)
        serial = read_serial(frame) if self._datagrams else b""
        board = self._identified.get(key) if serial is None else self._board_number(frame.node, serial)
        if serial is None and board is None:
            return Route(frame.node, should_identify=self._hold(key, held, t_ns))
        waited = self._release(key)
        if board is None:
            self.frames_refused += 1
            return Route(frame.node)
        self._identified[key] = board
        self._identified.move_to_end(key)
        if len(self._identified) > MAX_SENDERS:
            self._identified.popitem(last=False)
        self._addresses[frame.node, board] = sender
        return Route(frame.node, board, [*waited, held])

    def _board_number(self, node_id: int, serial: bytes) -> int | None:
        """Return the number of a board among those of its node id; None beyond MAX_NODES."""
        board = self._boards.get((node_id, serial))
        if board is None and len(self._boards) < MAX_NODES:
            board = self._board_counts.get(node_id, 0)
            self._board_counts[node_id] = board + 1
            self._boards[node_id, serial] = board
        return board

    def _hold(self, key: Sender, held: PendingFrame, t_ns: int) -> bool:
        """Hold a frame until its sender's Hello; return True if the Hello is to be requested now."""
        sender = self._unidentified.setdefault(key, _UnidentifiedSender())
        self._unidentified.move_to_end(key)
        sender.frames.append(held)
        self._held_count += 1
        while self._held_count > _MAX_HELD_FRAMES or len(self._unidentified) > MAX_SENDERS:
            oldest = next(iter(self._unidentified))
            if oldest == key:  # the only sender, with the maximum of held frames
                sender.frames.pop(0)
                self._held_count -= 1
                continue
            self._release(oldest)
            self.senders_evicted += 1
        if t_ns < sender.next_request_ns:
            return False
        sender.next_request_ns = t_ns + _IDENTIFY_INTERVAL_NS
        return True

    def _release(self, key: Sender) -> list[PendingFrame]:
        sender = self._unidentified.pop(key, None)
        if sender is None:
            return []
        self._held_count -= len(sender.frames)
        return sender.frames
