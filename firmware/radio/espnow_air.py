"""Receiving side of ESP-NOW: frames of nodes, and requests to them."""

from framing import START
from micropython import const

from radio.espnow_link import ANSWER, BROADCAST_FLAG, HEAD, MAX_PACKET, NODE, NUMBER, is_ours, open_radio
from radio.reception import Reception

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_PER_TURN = const(8)
_RECEIVE_BYTES = const(8192)
"""Bytes of receive buffer while the host is served: two nodes at 208 Hz fill it in some 0.6 s."""
_STRONG_DBM = const(-64)


class EspNowAir:
    """Counterpart of `nrf24_air.Nrf24Air` for ESP-NOW."""

    def __init__(self, board, outbox):
        settings = board.settings
        self.ids = tuple(settings["radio_nodes"][:5])
        self.nodes = tuple(Reception(outbox) for _ in self.ids)
        self._radio = open_radio(settings, _RECEIVE_BYTES)
        self._net = bytes.fromhex(settings["radio_address"])
        self._came: Any = [None, bytearray(MAX_PACKET), 0, 0]
        self._out = bytearray(MAX_PACKET)
        self._out[:NODE] = self._net

    def receive(self, ms):
        """Process received packets; return True if there may be more."""
        for _ in range(_PER_TURN):
            size = self._radio.recvinto(self._came, 0)
            if not size:
                for node in self.nodes:
                    node.step(ms)
                return False
            raw = self._came[1]
            if size > HEAD and is_ours(raw, self._net) and raw[NODE] in self.ids:
                self._process(self.nodes[self.ids.index(raw[NODE])], size, ms)
        return True

    def _process(self, node, size, ms):
        sender, raw, rssi, _ = self._came
        if node.address != sender:
            self._register(node, sender)
        if raw[NUMBER] & BROADCAST_FLAG:
            self._send(sender, ANSWER)
        node.strong += rssi > _STRONG_DBM
        node.add(raw[NUMBER] & ~BROADCAST_FLAG, raw, HEAD, size - HEAD, ms)

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
