"""Receiving side of ESP-NOW: frames of nodes, and requests to them."""

from time import ticks_diff

from framing import START
from micropython import const
from outbox import Slot

from radio.espnow_link import ANSWER, FIRST, HEAD, LAST, MAX_PACKET, NODE, NUMBER, TO_ALL, is_ours, open_radio

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_PER_TURN = const(8)
_RECEIVE_BYTES = const(8192)
"""Bytes of receive buffer while the host is served: two nodes at 208 Hz fill it in some 0.6 s."""
_STRONG_DBM = const(-64)
_DUPLICATE_MS = const(200)
"""Latest arrival of a duplicate; a restart of a node takes longer."""


class Reception:
    """Reception counters of one node, for `Signal`. lost: frames whose numbers are missing."""

    def __init__(self):
        self.frames = self.lost = self.received = self.repeated = self.strong = self.dropped = 0
        self.address = None
        self.number = -1
        self.new_ms = 0

    def is_new(self, number, ms):
        """Return True if a packet of that number is new; count those missing before it."""
        self.received += 1
        last = self.number
        ahead = (number - last) % LAST
        if number == FIRST and ticks_diff(ms, self.new_ms) > _DUPLICATE_MS:
            # The node has restarted.
            ahead = 1
        elif last < 0:
            ahead = 1
        elif not 0 < ahead <= LAST - _PER_TURN or number == FIRST:
            # A duplicate, or overtaken by others.
            self.repeated += 1
            return False
        self.lost += ahead - 1
        self.number, self.new_ms = number, ms
        return True


class EspNowAir:
    """Counterpart of `nrf24_air.Nrf24Air` for ESP-NOW."""

    def __init__(self, board, outbox):
        settings = board.settings
        self.ids = tuple(settings["radio_nodes"][:5])
        self.nodes = tuple(Reception() for _ in self.ids)
        self._outbox = outbox
        self._radio = open_radio(settings, _RECEIVE_BYTES)
        self._net = bytes.fromhex(settings["radio_address"])
        self._came: Any = [None, bytearray(MAX_PACKET), 0, 0]
        self._out = bytearray(MAX_PACKET)
        self._out[:NODE] = self._net
        self._slot = Slot()

    def receive(self, ms):
        """Process received packets; return True if there may be more."""
        for _ in range(_PER_TURN):
            size = self._radio.recvinto(self._came, 0)
            if not size:
                return False
            raw = self._came[1]
            if size > HEAD and is_ours(raw, self._net) and raw[NODE] in self.ids:
                self._process(self.nodes[self.ids.index(raw[NODE])], size, ms)
        return True

    def _process(self, node, size, ms):
        sender, raw, rssi, _ = self._came
        if node.address != sender:
            self._register(node, sender)
        if raw[NUMBER] & TO_ALL:
            self._send(sender, ANSWER)
        node.strong += rssi > _STRONG_DBM
        if not node.is_new(raw[NUMBER] & ~TO_ALL, ms):
            return
        node.frames += 1
        slot = self._slot
        for i in range(size - HEAD):
            slot.raw[START + i] = raw[HEAD + i]
        slot.end = START + size - HEAD + 1
        slot.raw[slot.end - 1] = 0
        self._slot = self._outbox.queue(slot)

    def _register(self, node, sender):
        """Register another board as that node."""
        try:
            if node.address is not None:
                self._radio.del_peer(node.address)
            self._radio.add_peer(sender)
        except OSError:
            # Already registered.
            pass
        node.address = sender

    def step(self, ms):
        """Do nothing: packets are whole frames."""

    def answer(self, k, raw, end):
        """Send raw[START:end] to the node ids[k]."""
        node, size = self.nodes[k], end - START
        if node.address is None or size > MAX_PACKET - ANSWER:
            node.dropped += 1
            return
        for i in range(size):
            self._out[ANSWER + i] = raw[START + i]
        if not self._send(node.address, ANSWER + size):
            node.dropped += 1

    def _send(self, address, size):
        try:
            return self._radio.send(address, memoryview(self._out)[:size], False)
        except OSError:
            return False
