"""Receiving side of nRF24L01+: frames of nodes, and requests to them."""

from time import ticks_add, ticks_diff, ticks_ms

from drivers.nrf24 import MAX_PACKET, NONE, RX_DR, TX_DS, TX_FULL, address_of, open_radio
from framing import START
from micropython import const

from radio.pieces import Pieces

_PER_TURN = const(8)
_UNFETCHED_MS = const(2000)
"""A request not fetched for this long is discarded, as it blocks others."""


class Nrf24Air:
    """Receives frames over an nRF24L01+.

    ids: ids of the received nodes; nodes: their `Pieces`, with the counters of `Signal`.
    """

    def __init__(self, board, outbox):
        settings = board.settings
        self.ids = tuple(settings["radio_nodes"][:5])
        self.nodes = tuple(Pieces(outbox) for _ in self.ids)
        self._radio = open_radio(board)
        net = settings["radio_address"]
        self._radio.listen_to([address_of(net, node_id) for node_id in self.ids])
        self._unfetched_ms = ticks_ms()

    def receive(self, ms):
        """Process received packets; return True if there were any."""
        radio = self._radio
        status, turns = radio.status(), _PER_TURN
        while status >> 1 & 7 != NONE and turns:
            turns -= 1
            self._process((status >> 1 & 7) - 1, ms)
            status = radio.status()
        if status & TX_DS:
            # A node has fetched a request.
            self._unfetched_ms = ticks_add(ms, _UNFETCHED_MS)
            radio.clear(TX_DS)
        return turns < _PER_TURN

    def _process(self, pipe, ms):
        radio = self._radio
        size = radio.read()
        radio.clear(RX_DR)
        if size > 1 and 0 <= pipe < len(self.nodes):
            pieces = self.nodes[pipe]
            pieces.add(radio.came, 1, size, ms)
            pieces.strong += radio.is_strong()

    def step(self, ms):
        """Discard frames whose missing pieces are overdue."""
        for pieces in self.nodes:
            pieces.step(ms)

    def answer(self, k, raw, end):
        """Queue raw[START:end] for the next acknowledgements to the node ids[k], in packets."""
        radio, ms = self._radio, ticks_ms()
        if radio.status() & TX_FULL and ticks_diff(ms, self._unfetched_ms) >= 0:
            radio.flush()
            self._unfetched_ms = ticks_add(ms, _UNFETCHED_MS)
        at = START
        while at < end:
            if radio.status() & TX_FULL:
                self.nodes[k].dropped += 1
                return
            size = end - at if end - at < MAX_PACKET else MAX_PACKET
            for i in range(size):
                radio.out[1 + i] = raw[at + i]
            radio.answer(k + 1, size)
            at += size
