"""Nodes of one id on one datagram port, told apart: by where they send from, and by the serial of a Hello."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from hubodo.ingest.node.gaps import LinkCounts
from hubowire import Frame
from hubowire.messages import Hello

_MOST_HELD = 512
_SERIAL = slice(7, 15)
Held = tuple[Frame, int, LinkCounts]


def serial_of(frame: Frame) -> bytes | None:
    """The serial that a Hello tells; None for other frames, and for one too short."""
    told = frame.payload[_SERIAL]
    return told if frame.type_id == Hello.type_id and len(told) == 8 else None


@dataclass(slots=True)
class Senders:
    """Of one node id: which number its boards have, from 0 on in the order of their coming.

    A board that comes back from another address, as after a restart, keeps its number.
    """

    _places: dict[str, int] = field(default_factory=dict)
    _serials: dict[bytes, int] = field(default_factory=dict)
    _held: dict[str, deque[Held]] = field(default_factory=dict)
    _count: int = 0

    def route(self, held: Held, sender: str) -> tuple[int, list[Held]] | None:
        """The number of the board that has sent a frame, and what of it may be read now.

        None while it is not known whose it is: its Hello tells, and until then its frames are kept.
        """
        serial = serial_of(held[0])
        place = self._places.get(sender)
        if serial is None:
            if place is None and self._count:
                self._held.setdefault(sender, deque(maxlen=_MOST_HELD)).append(held)
                return None
            place = self._new() if place is None else place
        else:
            known = self._serials.get(serial)
            if known is not None:
                place = known
            elif place is None or place in self._serials.values():
                place = self._new()
            self._serials[serial] = place
        self._places[sender] = place
        return place, [*self._held.pop(sender, ()), held]

    def _new(self) -> int:
        self._count += 1
        return self._count - 1
