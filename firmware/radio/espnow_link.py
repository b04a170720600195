"""Link by ESP-NOW to a receiver: one frame per packet, requests in packets of their own.

A packet is the four bytes of the network, node id, packet number, and the frame without its final zero. One
packet is in flight at a time and is repeated until acknowledged; frames wait in the outbox meanwhile, as on
every link. A receiver's packet has node id 0, then bytes of requests. Addresses are learnt: a node without a
receiver broadcasts, the receiver answers with an empty packet, and the node then sends to its address.
"""

from time import ticks_add, ticks_diff, ticks_ms

import network
from espnow import ESPNow
from framing import START
from link import Link
from micropython import const

from radio import FIRST, LAST

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

MAX_PACKET = const(250)
HEAD = const(6)
NODE = const(4)
NUMBER = ANSWER = const(5)
"""Offset of the number in a node's packet, and of the bytes in a receiver's."""
BROADCAST_FLAG = const(0x80)
"""Flag in the number of a packet: it was broadcast."""
BROADCAST = b"\xff" * 6
_REQUEST_BYTES = const(526)
_AGAIN_MS = const(5)
_LOST_MS = const(3000)
_UNANSWERED_MS = const(500)


def open_radio(settings, room):
    """Return ESP-NOW, active on the Wi-Fi channel of the network. room: bytes of receive buffer."""
    wlan = network.WLAN(network.STA_IF)
    wlan.active(True)
    for option in ({"channel": settings["espnow_channel"]}, {"pm": network.WLAN.PM_NONE}):
        try:
            wlan.config(**option)
        except (OSError, TypeError, ValueError):
            # A version may lack an option; the channel at power-on is 1.
            pass
    radio = ESPNow()
    radio.config(rxbuf=room)
    radio.active(True)
    return radio


def is_ours(raw, net):
    """Return True if a packet begins with the bytes of the network."""
    for i in range(NODE):
        if raw[i] != net[i]:
            return False
    return True


class EspNowLink(Link):
    """A link to the receiver that answered, by ESP-NOW."""

    def __init__(self, board):
        super().__init__()
        settings = board.settings
        self._radio = radio = open_radio(settings, _REQUEST_BYTES)
        radio.add_peer(BROADCAST)
        self._net = bytes.fromhex(settings["radio_address"])
        self._out = bytearray(MAX_PACKET)
        self._outs = memoryview(self._out)
        self._out[:NODE] = self._net
        self._out[NODE] = settings["node_id"]
        self._came: Any = [None, bytearray(MAX_PACKET)]
        self._at = self._end = 0
        self._to = BROADCAST
        self._number = FIRST
        self._in_flight = False
        self._sent = self._failed = 0
        self._size = 0
        self._again_ms = self._sent_ms = self._good_ms = ticks_ms()

    def send(self, outbox):
        ms = ticks_ms()
        if self._in_flight:
            if not self._completed(outbox, ms):
                return
        if outbox.count and ticks_diff(ms, self._again_ms) >= 0:
            self._send_frame(outbox, ms)

    def _send_frame(self, outbox, ms):
        """Send the oldest frame; the outbox retains it until it is acknowledged."""
        if outbox.sent < 0:
            # The zero before the first frame is for byte streams.
            outbox.advance(-outbox.sent)
        slot = outbox.oldest()
        size = self._size = slot.end - START - 1
        if size > MAX_PACKET - HEAD:
            outbox.dropped += 1
            outbox.advance(slot.end - START - outbox.sent)
            return
        if not outbox.sent:
            outbox.advance(1)
        to_all = self._to is BROADCAST
        out, raw = self._out, slot.raw
        out[NUMBER] = self._number | (BROADCAST_FLAG if to_all else 0)
        for i in range(size):
            out[HEAD + i] = raw[START + i]
        try:
            self._radio.send(self._to, self._outs[: HEAD + size], False)
            self._in_flight = True
            self._sent_ms = ms
        except OSError:
            self._again_ms = ticks_add(ms, _AGAIN_MS)

    def _completed(self, outbox, ms):
        """Return True if the packet in flight is acknowledged or failed; a failed one is sent again."""
        sent, answered, failed, _, _ = self._radio.stats()
        if answered != sent and ticks_diff(ms, self._sent_ms) < _UNANSWERED_MS:
            return False
        self._in_flight = False
        if failed == self._failed and answered == sent:
            self._good_ms = ms
            self._number = self._number + 1 if self._number < LAST else 1
            outbox.advance(self._size)
            return True
        self._failed = failed
        self._again_ms = ticks_add(ms, _AGAIN_MS)
        if ticks_diff(ms, self._good_ms) >= _LOST_MS and self._to is not BROADCAST:
            # The receiver may have been replaced.
            self._radio.del_peer(self._to)
            self._to = BROADCAST
        return True

    def _byte(self):
        if self._at == self._end:
            size = self._radio.recvinto(self._came, 0)
            sender, raw = self._came
            if size < ANSWER or raw[NODE] or not is_ours(raw, self._net):
                return -1
            if self._to is BROADCAST:
                self._to = sender
                self._radio.add_peer(sender)
                self._good_ms = ticks_ms()
            if sender != self._to or size == ANSWER:
                return -1
            self._at, self._end = ANSWER, size
        self._at += 1
        return self._came[1][self._at - 1]
