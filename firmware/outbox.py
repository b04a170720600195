"""Frames that wait for the link: a fixed number of slots, the oldest given up first, and counted.

Slots are never copied: who fills one hands it in and gets an empty one back.
"""

import struct
from array import array

from buffers import shared
from framing import PAYLOAD, SLOT_WORDS, START, seal
from micropython import const
from wire import HEADER_FORMAT, IMU_BATCH_MAX_ROWS, IMU_BATCH_SIZE, TIME_REPLY

_BODY = const(2)
FIRST_ROW = (PAYLOAD + IMU_BATCH_SIZE) // 2
"""Where the samples of an ImuBatch begin, in int16 from the start of a slot."""

ROW = const(6)
_TYPES = const(16)
"""Types of message that a node sends are below this."""


class Slot:
    """Room for one frame.

    raw: the frame's bytes; values: the same memory as int16; rows: the bytes of the samples of a full batch,
    only after `shape`; end: where the frame ends in raw, once sealed.
    """

    rows = None

    def __init__(self):
        self.raw, self.values = shared(SLOT_WORDS)
        self.end = START

    def shape(self, batch):
        """Fits `rows` to batches of that many samples."""
        first = 2 * FIRST_ROW
        self.rows = memoryview(self.raw)[first : first + 2 * ROW * batch]


class Outbox:
    """Ring of `depth` sealed frames."""

    def __init__(self, depth, node_id):
        self.node_id = node_id
        self.dropped = 0
        self.high_water = 0
        self.count = 0
        self.sent = -START
        """Bytes of the oldest frame that the link has taken; the first has a zero before it, which ends what
        a restart has cut off."""
        self._depth = depth
        self._ring = [Slot() for _ in range(depth)]
        self._head = 0
        self._seqs = array("H", bytes(2 * _TYPES))
        self._note = Slot()

    def shape(self, batch):
        """Fits every slot to batches of that many samples."""
        self._note.shape(batch)
        for slot in self._ring:
            slot.shape(batch)

    def note(self):
        """The bytes to pack a small message into, from PAYLOAD on, for `post`."""
        return self._note.raw

    def post(self, type_id, payload_size):
        """Queues what was packed into `note`."""
        self._note = self.exchange(self._note, type_id, payload_size)

    def exchange(self, slot, type_id, payload_size):
        """Queues a filled slot; returns an empty one in its place."""
        seqs = self._seqs
        seq = seqs[type_id]
        seqs[type_id] = seq + 1 & 0xFFFF
        struct.pack_into(HEADER_FORMAT, slot.raw, _BODY, type_id, self.node_id, seq)
        slot.end = seal(slot.raw, PAYLOAD + payload_size)
        return self.queue(slot)

    def queue(self, slot):
        """Queues a sealed slot; returns an empty one in its place."""
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
        """The slot to send next, or None."""
        return self._ring[self._head] if self.count else None

    def took(self, size):
        """The link took `size` more bytes of the oldest frame."""
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
            # Half of the oldest is on the wire already: it stays, the next one goes.
            ring[head], ring[after] = ring[after], ring[head]
        self._head = after
        self.count -= 1
        self.dropped += 1


assert TIME_REPLY < _TYPES
assert FIRST_ROW + ROW * IMU_BATCH_MAX_ROWS <= SLOT_WORDS
assert PAYLOAD + IMU_BATCH_SIZE == 2 * FIRST_ROW
