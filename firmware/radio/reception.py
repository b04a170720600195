"""Packets of one ESP-NOW node: each number is accepted once, frames are forwarded in order."""

from time import ticks_diff

from framing import START
from micropython import const
from outbox import Slot

from radio import FIRST, LAST

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_REPLAY_WINDOW = const(64)
"""Numbers before the next one that belong to duplicates, or to packets that came too late."""
_HELD = const(16)
_HOLD_MS = const(30)
"""Time for which frames wait for one that they have overtaken."""
_DUPLICATE_MS = const(200)
"""Latest arrival of a duplicate; a restart of a node takes longer."""


class Reception:
    """Puts the frames of one node in order, and counts them for `Signal`.

    frames: accepted; lost: missing by their numbers; received: packets; repeated: duplicates, and packets
    that came later than the wait for them.
    """

    def __init__(self, outbox):
        self._outbox = outbox
        self.frames = self.lost = self.received = self.repeated = self.strong = self.dropped = 0
        self.address = None
        self._next = -1
        self._held: list[Any] = [None] * _HELD
        """Frames of the numbers from the next one on; None: not received."""
        self._count = 0
        self._free = []
        self._new_ms = self._since_ms = 0
        """Times of the last new packet, and since which the next in order is waited for."""

    def add(self, number, raw, at, size, ms):
        """Add the frame raw[at:at + size], without its final zero, of the packet with this number."""
        self.received += 1
        ahead = self._place(number, ms)
        while ahead >= _HELD:
            self._forward()
            ahead -= 1
        if ahead < 0 or self._held[ahead]:
            self.repeated += 1
            return
        self.frames += 1
        self._new_ms = ms
        if not self._count or not ahead:
            self._since_ms = ms
        slot = self._free.pop() if self._free else Slot()
        into = slot.raw
        for i in range(size):
            into[START + i] = raw[at + i]
        slot.end = START + size + 1
        into[slot.end - 1] = 0
        self._held[ahead] = slot
        self._count += 1
        self._forward_complete()

    def step(self, ms):
        """Give up on the frames that others have waited for too long."""
        if self._count and ticks_diff(ms, self._since_ms) >= _HOLD_MS:
            while not self._held[0]:
                self._forward()
            self._since_ms = ms
            self._forward_complete()

    def _place(self, number, ms):
        """Return how many numbers lie between this one and the next in order; -1 for a duplicate."""
        if self._next < 0 or (number == FIRST and ticks_diff(ms, self._new_ms) > _DUPLICATE_MS):
            # The receiver, or the node, has restarted.
            while self._count:
                self._forward()
            self._next = number
            return 0
        ahead = (number - self._next) % LAST
        return -1 if number == FIRST or ahead >= LAST - _REPLAY_WINDOW else ahead

    def _forward_complete(self):
        while self._held[0]:
            self._forward()

    def _forward(self):
        """Queue the next frame for the host, or count it as lost."""
        slot = self._held.pop(0)
        self._held.append(None)
        self._next = self._next + 1 if self._next < LAST else 1
        if slot is None:
            self.lost += 1
        else:
            self._count -= 1
            self._free.append(self._outbox.queue(slot))
