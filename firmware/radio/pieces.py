"""Reassembly of the frames of one node from packets that may be lost, repeated or reordered."""

from time import ticks_diff

from framing import START
from micropython import const
from outbox import Slot

_PIECE_BYTES = const(30)
_HEADER_BYTES = const(2)
_MAX_PIECES = const(9)
_FRAME_BYTES = const(250)
_PIECE_TIMEOUT_MS = const(2000)
_REORDER_FRAMES = const(16)
_ZERO = b"\0"


class Pieces:
    """Reassembles frames from packets and queues complete ones in `outbox`.

    frames, lost, received, repeated: counters of `Signal`. lost: frames incomplete or missing by their
    numbers; received: packets; repeated: duplicates.
    """

    def __init__(self, outbox):
        self._outbox = outbox
        self.frames = self.lost = self.received = self.repeated = self.strong = self.dropped = 0
        self._slots = [Slot(), Slot()]
        self._numbers = [-1, -1]
        self._missing = [0, 0]
        self._since_ms = [0, 0]
        self._newest = -1
        self._done = 0
        """Bit k: the frame k before the newest is complete or was discarded."""

    def add(self, raw, at, size, ms):
        """Add the packet raw[at:at + size] with its header."""
        self.received += 1
        number, place, last = raw[at], raw[at + 1] >> 4, raw[at + 1] & 0x0F
        size -= _HEADER_BYTES
        if size <= 0 or last >= _MAX_PIECES or place > last or (size < _PIECE_BYTES and place < last):
            return
        k = self._slot_for(number, last, ms)
        if k < 0 or not self._missing[k] >> place & 1:
            self.repeated += 1
            return
        to, at, into = START + _PIECE_BYTES * place, at + _HEADER_BYTES, self._slots[k].raw
        if place == last:
            if to + size > START + _FRAME_BYTES:
                return
            into[to + size - 1] = 0
        for i in range(size):
            into[to + i] = raw[at + i]
        self._missing[k] &= ~(1 << place)
        if place == last:
            self._slots[k].end = to + size
        if not self._missing[k]:
            self._complete(k)

    def step(self, ms):
        """Discard frames whose missing pieces are overdue."""
        for k in range(2):
            if self._numbers[k] >= 0 and ticks_diff(ms, self._since_ms[k]) > _PIECE_TIMEOUT_MS:
                self._give_up(k)

    def _slot_for(self, number, last, ms):
        """Return the slot for this frame; -1 if it is complete or discarded already."""
        numbers = self._numbers
        if number == numbers[0]:
            return 0
        if number == numbers[1]:
            return 1
        ahead = 1 if self._newest < 0 else (number - self._newest + 128 & 0xFF) - 128
        if ahead > 0:
            if ahead > 1:
                self.lost += ahead - 1
            self._done = (
                (self._done << ahead) & ((1 << _REORDER_FRAMES) - 1) if ahead < _REORDER_FRAMES else 0
            )
            self._newest = number
        elif -ahead >= _REORDER_FRAMES or self._done >> -ahead & 1:
            return -1
        else:
            # A packet that arrives late was counted as lost.
            self.lost -= 1
        k = 0 if numbers[0] < 0 else 1
        if numbers[k] >= 0:
            k = 0 if ticks_diff(self._since_ms[0], self._since_ms[1]) <= 0 else 1
            self._give_up(k)
        numbers[k] = number
        self._missing[k] = (2 << last) - 1
        self._since_ms[k] = ms
        return k

    def _complete(self, k):
        slot = self._slots[k]
        self._close(k)
        # A COBS frame contains exactly one zero, at the end.
        if slot.raw.find(_ZERO, START, slot.end) != slot.end - 1:
            self.lost += 1
            return
        self.frames += 1
        self._slots[k] = self._outbox.queue(slot)

    def _give_up(self, k):
        self.lost += 1
        self._close(k)

    def _close(self, k):
        back = self._newest - self._numbers[k] & 0xFF
        if back < _REORDER_FRAMES:
            self._done |= 1 << back
        self._numbers[k] = -1
