"""Reassembly of the frames of one node from packets that may be lost, repeated or reordered."""

from time import ticks_diff

from framing import START
from micropython import const
from outbox import Slot

_PIECE = const(30)
_HEAD = const(2)
_MOST = const(9)
_ROOM = const(250)
_LATE_MS = const(2000)
_WINDOW = const(16)
_ZERO = b"\0"


class Pieces:
    """Reassembles frames from packets and queues complete ones in `outbox`.

    frames, lost, heard, twice: counters of `Signal`. `lost`: incomplete or missing frames, by their numbers.
    """

    def __init__(self, outbox):
        self._outbox = outbox
        self.frames = self.lost = self.heard = self.twice = self.strong = self.dropped = 0
        self._slots = [Slot(), Slot()]
        self._numbers = [-1, -1]
        self._missing = [0, 0]
        self._since_ms = [0, 0]
        self._newest = -1
        self._done = 0
        """Bit k: the frame k before the newest is complete or was discarded."""

    def take(self, raw, at, size, ms):
        """Add the packet raw[at:at + size] with its header."""
        self.heard += 1
        number, place, last = raw[at], raw[at + 1] >> 4, raw[at + 1] & 0x0F
        size -= _HEAD
        if size <= 0 or last >= _MOST or place > last or (size < _PIECE and place < last):
            return
        k = self._open(number, last, ms)
        if k < 0 or not self._missing[k] >> place & 1:
            self.twice += 1
            return
        to, at, into = START + _PIECE * place, at + _HEAD, self._slots[k].raw
        if place == last:
            if to + size > START + _ROOM:
                return
            into[to + size - 1] = 0
        for i in range(size):
            into[to + i] = raw[at + i]
        self._missing[k] &= ~(1 << place)
        if place == last:
            self._slots[k].end = to + size
        if not self._missing[k]:
            self._whole(k)

    def turn(self, ms):
        """Discard frames whose missing pieces are overdue."""
        for k in range(2):
            if self._numbers[k] >= 0 and ticks_diff(ms, self._since_ms[k]) > _LATE_MS:
                self._give_up(k)

    def _open(self, number, last, ms):
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
            self._done = (self._done << ahead) & ((1 << _WINDOW) - 1) if ahead < _WINDOW else 0
            self._newest = number
        elif -ahead >= _WINDOW or self._done >> -ahead & 1:
            return -1
        else:
            # It had been counted as lost.
            self.lost -= 1
        k = 0 if numbers[0] < 0 else 1
        if numbers[k] >= 0:
            k = 0 if ticks_diff(self._since_ms[0], self._since_ms[1]) <= 0 else 1
            self._give_up(k)
        numbers[k] = number
        self._missing[k] = (2 << last) - 1
        self._since_ms[k] = ms
        return k

    def _whole(self, k):
        slot = self._slots[k]
        self._end(k)
        # A COBS frame contains exactly one zero, at the end.
        if slot.raw.find(_ZERO, START, slot.end) != slot.end - 1:
            self.lost += 1
            return
        self.frames += 1
        self._slots[k] = self._outbox.queue(slot)

    def _give_up(self, k):
        self.lost += 1
        self._end(k)

    def _end(self, k):
        back = self._newest - self._numbers[k] & 0xFF
        if back < _WINDOW:
            self._done |= 1 << back
        self._numbers[k] = -1
