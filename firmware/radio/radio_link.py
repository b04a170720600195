"""Link by nRF24L01+ to a receiver: frames in pieces, requests in the acknowledgements.

A piece is the number of its frame, its position and the number of pieces, then up to 30 bytes. It is repeated
until acknowledged; frames wait in the outbox meanwhile, as on every link.
"""

from time import ticks_add, ticks_diff, ticks_ms

import machine
from drivers.nrf24 import MAX_PACKET, MAX_RT, NONE, RX_DR, TX_DS, TX_FULL, address_of, open_radio
from framing import START
from link import Link
from micropython import const

PIECE = const(30)
HEAD = const(2)
_POLL_MS = const(20)
"""Interval after the last packet at which an empty one fetches requests from the receiver."""
_AGAIN_MS = const(5)
_MAX_QUEUED_PIECES = const(9)
_MAX_RETRIES = const(15)


class RadioLink(Link):
    """A link to the receiver of the network; without acknowledgements (radio_tries 0) packets may be lost."""

    def __init__(self, board):
        super().__init__()
        settings = board.settings
        self._radio = radio = open_radio(board)
        tries = settings["radio_tries"]
        self._acknowledged = tries > 0
        # Different pauses: nodes whose packets collided must not collide again.
        pause_us = (1500 if settings["radio_kbps"] == 250 else 500) + 250 * (5 * settings["node_id"] % 11)
        radio.send_to(
            address_of(settings["radio_address"], settings["node_id"]), tries or _MAX_RETRIES, pause_us
        )
        self._in = bytearray(MAX_PACKET)
        self._number = 0
        self._size = self._at = 0
        self._again_ms = self._poll_ms = ticks_ms()

    def send(self, outbox):
        radio, ms = self._radio, ticks_ms()
        status = radio.status()
        if status & MAX_RT:
            if ticks_diff(ms, self._again_ms) < 0:
                return
            self._again_ms = ticks_add(ms, _AGAIN_MS)
            radio.clear(MAX_RT)
        turns = _MAX_QUEUED_PIECES
        while outbox.count and not status & TX_FULL and turns:
            turns -= 1
            status = self._send_piece(outbox)
            self._poll_ms = ticks_add(ms, _POLL_MS)

    def sleep(self, ms):
        """Sleep with the radio off; packets that it has not sent by then wait in its FIFO."""
        self._radio.halt()
        machine.lightsleep(ms)
        self._radio.resume()

    def _send_piece(self, outbox):
        """Queue the next piece of the oldest frame; return the status register."""
        radio, slot = self._radio, outbox.oldest()
        sent = outbox.sent if outbox.sent > 0 else 0
        if outbox.sent < 0:
            # The zero before the first frame is for byte streams.
            outbox.advance(-outbox.sent)
        whole = slot.end - START
        size = whole - sent
        if size > PIECE:
            size = PIECE
        out, raw = radio.out, slot.raw
        out[1] = self._number
        out[2] = (sent // PIECE) << 4 | (whole - 1) // PIECE
        at = START + sent
        for i in range(size):
            out[1 + HEAD + i] = raw[at + i]
        radio.write(HEAD + size, self._acknowledged)
        if sent + size == whole:
            self._number = self._number + 1 & 0xFF
        outbox.advance(size)
        return radio.status()

    def _byte(self):
        if self._at == self._size:
            self._at = self._size = 0
            radio = self._radio
            status = radio.status()
            if status >> 1 & 7 == NONE:
                self._poll(status)
                return -1
            self._size = radio.read()
            radio.clear(RX_DR | TX_DS)
            if not self._size:
                return -1
            for i in range(self._size):
                self._in[i] = radio.came[1 + i]
        self._at += 1
        return self._in[self._at - 1]

    def _poll(self, status):
        ms = ticks_ms()
        if ticks_diff(ms, self._poll_ms) >= 0 and not status & (TX_FULL | MAX_RT):
            self._poll_ms = ticks_add(ms, _POLL_MS)
            self._radio.out[1] = 0
            self._radio.write(1)
