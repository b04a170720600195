"""Send queue: a fixed number of slots; when it is full the oldest frame is dropped and counted.

Slots are never copied: whoever fills one passes it in and gets an empty one back.
"""

import struct
from array import array

from buffers import shared
from framing import PAYLOAD, SLOT_WORDS, START, seal
from micropython import const
from wire import HEADER_FORMAT, IMU_BATCH_MAX_ROWS, IMU_BATCH_SIZE, TIME_REPLY

_BODY = const(2)
FIRST_ROW = (PAYLOAD + IMU_BATCH_SIZE) // 2
"""Offset of the samples of an ImuBatch, in int16 from the start of a slot."""

ROW = const(6)
_TYPES = const(16)
"""Bound on the message types that a node sends."""


class Slot:
    """Buffer for one frame.

    raw: its bytes; values: the same memory as int16; rows: the bytes of the samples of a full batch, only
    after `shape`; end: end of the sealed frame in raw.
    """

    rows = None

    def __init__(self):
        self.raw, self.values = shared(SLOT_WORDS)
        self.end = START

    def shape(self, batch):
        """Set the length of `rows` to a batch of `batch` samples."""
        first = 2 * FIRST_ROW
        self.rows = memoryview(self.raw)[first : first + 2 * ROW * batch]


class Outbox:
    """A ring buffer of `depth` sealed frames."""

    def __init__(self, depth, node_id):
        self.node_id = node_id
        self.dropped = 0
        self.high_water = 0
        self.count = 0
        self.sent = -START
        """Bytes of the oldest frame that are sent; negative at the start, as a zero goes before the first
        frame, which delimits what a restart cut off."""
        self._depth = depth
        self._ring = [Slot() for _ in range(depth)]
        self._head = 0
        self._seqs = array("H", bytes(2 * _TYPES))
        self._note = Slot()

    def shape(self, batch):
        """Set the length of `rows` of every slot to a batch of `batch` samples."""
        self._note.shape(batch)
        for slot in self._ring:
            slot.shape(batch)

    def note(self):
        """Return the buffer to pack a small message into, from PAYLOAD on, for `post`."""
        return self._note.raw

    def post(self, type_id, payload_size):
        """Queue the message packed into `note`."""
        self._note = self.exchange(self._note, type_id, payload_size)

    def exchange(self, slot, type_id, payload_size):
        """Seal and queue a filled slot; return an empty one in exchange."""
        seqs = self._seqs
        seq = seqs[type_id]
        seqs[type_id] = seq + 1 & 0xFFFF
        struct.pack_into(HEADER_FORMAT, slot.raw, _BODY, type_id, self.node_id, seq)
        slot.end = seal(slot.raw, PAYLOAD + payload_size)
        return self.queue(slot)

    def queue(self, slot):
        """Queue a sealed slot; return an empty one in exchange."""
        ring, depth = self._ring, self._depth
        count = self.count
        if count == depth:
            self._drop_oldest()
            count -= 1
        tail = self._head + count
        if tail >= depth:
            tail -= depth
        free = ring[tail]
        ring[tail] = slot
        count += 1
        self.count = count
        if count > self.high_water:
            self.high_water = count
        return free

    def oldest(self):
        """Return the slot to send next, or None."""
        return self._ring[self._head] if self.count else None

    def advance(self, size):
        """Count `size` more bytes of the oldest frame as sent."""
        size += self.sent
        head = self._head
        if START + size < self._ring[head].end:
            self.sent = size
            return
        self.sent = 0
        self.count -= 1
        head += 1
        self._head = head if head < self._depth else 0

    def _drop_oldest(self):
        ring, head = self._ring, self._head
        after = (head + 1) % self._depth
        if self.sent > 0:
            # Part of the oldest is on the wire already: drop the next one instead.
            ring[head], ring[after] = ring[after], ring[head]
        self._head = after
        self.count -= 1
        self.dropped += 1


assert TIME_REPLY < _TYPES
assert FIRST_ROW + ROW * IMU_BATCH_MAX_ROWS <= SLOT_WORDS
assert PAYLOAD + IMU_BATCH_SIZE == 2 * FIRST_ROW
