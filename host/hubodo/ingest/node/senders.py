"""Which board a frame comes from: on a datagram port by address and serial, in tables of bounded size."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from hubodo.ingest.node.gaps import LinkCounts
from hubowire import Frame
from hubowire.messages import Hello

MAX_NODES = 64
"""Nodes on one link; Hellos of further ones are refused."""
MAX_SENDERS = 256
"""Addresses that speak for identified nodes, and as many that have not identified themselves."""
_MAX_HELD = 2048  # frames of unidentified senders, which is about 1 MB
_ASK_EVERY_NS = 500_000_000
_HELLO_HEAD_BYTES = 7
_SERIAL = slice(7, 15)
Held = tuple[Frame, int, LinkCounts]
Sender = tuple[str, int]
"""An address and a node id."""


class Route(NamedTuple):
    """Where a frame goes.

    board: which of the boards with its node id, None while that is not known or where it is refused.
    frames: what can be decoded now, in order. ask: whether its sender is to be asked for its Hello.
    """

    node_id: int
    board: int | None = None
    frames: Sequence[Held] = ()
    ask: bool = False


@dataclass(slots=True)
class _Stranger:
    """A sender that has not identified itself yet."""

    ask_ns: int = 0
    frames: list[Held] = field(default_factory=list)


def serial_of(frame: Frame) -> bytes | None:
    """Return the serial in a Hello; None for other frames, and for a Hello too short for any version."""
    if frame.type_id != Hello.type_id or len(frame.payload) < _HELLO_HEAD_BYTES:
        return None
    return frame.payload[_SERIAL]


class SenderTable:
    """The boards behind one link, and the addresses they send from.

    A board is identified by the serial in its Hello and keeps its number when it comes back from another
    address, as after a restart; frames that came before that Hello wait for it. On a line with one sender the
    node id alone tells nodes apart. Addresses that have not identified themselves have a table of their own,
    from which the longest silent one is evicted first, so that they never cost an identified board anything.
    """

    def __init__(self, *, datagrams: bool) -> None:
        self.refused = 0
        """Frames of nodes beyond MAX_NODES."""
        self.evicted = 0
        """Unidentified senders that were dropped with the frames that waited."""
        self._datagrams = datagrams
        self._boards: dict[tuple[int, bytes], int] = {}
        self._counts: dict[int, int] = {}
        self._addresses: dict[tuple[int, int], str] = {}
        self._known: OrderedDict[Sender, int] = OrderedDict()
        self._strangers: OrderedDict[Sender, _Stranger] = OrderedDict()
        self._held = 0

    def address(self, node_id: int, board: int) -> str:
        """Return where a board sent from last."""
        return self._addresses.get((node_id, board), "")

    def is_known(self, sender: str, node_id: int) -> bool:
        """Return True when this address speaks for an identified board."""
        return (sender, node_id) in self._known

    def route(self, held: Held, sender: str) -> Route:
        """Return where a frame goes and which frames that waited for it go there first."""
        frame, t_ns, _ = held
        key = (sender, frame.node)
        serial = serial_of(frame) if self._datagrams else b""
        board = self._known.get(key) if serial is None else self._board(frame.node, serial)
        if serial is None and board is None:
            return Route(frame.node, ask=self._hold(key, held, t_ns))
        waited = self._release(key)
        if board is None:
            self.refused += 1
            return Route(frame.node)
        self._known[key] = board
        self._known.move_to_end(key)
        if len(self._known) > MAX_SENDERS:
            self._known.popitem(last=False)
        self._addresses[frame.node, board] = sender
        return Route(frame.node, board, [*waited, held])

    def _board(self, node_id: int, serial: bytes) -> int | None:
        """Return the number of a board among those of its node id; None for one too many."""
        board = self._boards.get((node_id, serial))
        if board is None and len(self._boards) < MAX_NODES:
            board = self._counts.get(node_id, 0)
            self._counts[node_id] = board + 1
            self._boards[node_id, serial] = board
        return board

    def _hold(self, key: Sender, held: Held, t_ns: int) -> bool:
        """Keep a frame until its sender says Hello; return whether that is to be asked for now."""
        stranger = self._strangers.setdefault(key, _Stranger())
        self._strangers.move_to_end(key)
        stranger.frames.append(held)
        self._held += 1
        while self._held > _MAX_HELD or len(self._strangers) > MAX_SENDERS:
            oldest = next(iter(self._strangers))
            if oldest == key:  # alone with all that may wait
                stranger.frames.pop(0)
                self._held -= 1
                continue
            self._release(oldest)
            self.evicted += 1
        if t_ns < stranger.ask_ns:
            return False
        stranger.ask_ns = t_ns + _ASK_EVERY_NS
        return True

    def _release(self, key: Sender) -> list[Held]:
        stranger = self._strangers.pop(key, None)
        if stranger is None:
            return []
        self._held -= len(stranger.frames)
        return stranger.frames
