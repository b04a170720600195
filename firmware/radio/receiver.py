"""A board that passes on what nodes send by radio: their frames to the host, its requests to them."""

import struct
from time import ticks_add, ticks_diff, ticks_ms, ticks_us

import reports
from commands import Commands
from drivers.nrf24 import MOST, NONE, RX_DR, TX_DS, TX_FULL, address_of, open_radio
from framing import BODY, PAYLOAD, START, FrameReader, seal
from micropython import const
from outbox import Outbox, Slot
from wire import SIGNAL, SIGNAL_FORMAT, SIGNAL_SIZE

from radio.pieces import Pieces

_HELLO_MS = const(5000)
_HEALTH_MS = const(1000)
_PER_TURN = const(8)
_FAREWELL_MS = const(300)
_UNKNOWN_US = const(65535)
_UNFETCHED_MS = const(2000)
"""A request that no node has fetched for so long stands in the way of others."""


class _Nothing:
    """The sensors of a board that has none, as `reports` and `commands` ask for them."""

    chip = mag = None
    faults = i2c_errors = recoveries = failures = overruns = missed = batch = 0
    found = ()

    def __init__(self):
        self.clock = self

    def bound_us(self):
        return _UNKNOWN_US


class Receiver:
    """One receiver on one board; `turn` is a round of its loop, `leave` becomes a RebootMode."""

    def __init__(self, board, link):
        self.board, self.link, self.settings = board, link, board.settings
        self.outbox = Outbox(self.settings["queue"], self.settings["node_id"])
        self.parts = self.sampler = _Nothing()
        self.commands = Commands(self)
        self.leave = None
        self.free_heap = self.worst_us = 0
        self.estimator = self.init = None
        self._radio = open_radio(board)
        self._ids = tuple(self.settings["radio_nodes"][:5])
        net = self.settings["radio_address"]
        self._radio.listen_to([address_of(net, node_id) for node_id in self._ids])
        self._pieces = tuple(Pieces(self.outbox) for _ in self._ids)
        self._request = Slot()
        self._unfetched_ms = self._hello_ms = self._health_ms = ticks_ms()
        reports.hello(self)

    def turn(self):
        """One round: hear, pass on, listen, tell how it fares."""
        now = ticks_us()
        radio, ms = self._radio, ticks_ms()
        status, turns = radio.status(), _PER_TURN
        while status >> 1 & 7 != NONE and turns:
            turns -= 1
            self._hear((status >> 1 & 7) - 1, ms)
            status = radio.status()
        if status & TX_DS:
            # A node has fetched what waited for it.
            self._unfetched_ms = ticks_add(ms, _UNFETCHED_MS)
            radio.clear(TX_DS)
        if self.outbox.count:
            self.link.send(self.outbox)
        if self.link.receive():
            self._requested(self.link.reader, ticks_us())
            self.link.send(self.outbox)
        if ticks_diff(ms, self._health_ms) >= 0:
            self._tell(ms)
        took = ticks_diff(ticks_us(), now)
        if took > self.worst_us:
            self.worst_us = took
        if turns == _PER_TURN:
            self.link.wait(1)

    def start(self):
        """There is nothing to sample: `commands` says so."""

    def stop(self):
        """Nothing is sampled."""

    def make_filter(self):
        """There is nothing to filter."""

    def farewell(self):
        """Gives the link a little time to take what still waits."""
        until = ticks_add(ticks_ms(), _FAREWELL_MS)
        while self.outbox.count and ticks_diff(until, ticks_ms()) > 0:
            self.link.send(self.outbox)
            self.board.feed()
            self.link.wait(1)

    def _hear(self, pipe, ms):
        radio = self._radio
        size = radio.read()
        radio.clear(RX_DR)
        if size > 1 and 0 <= pipe < len(self._pieces):
            pieces = self._pieces[pipe]
            pieces.take(radio.came, 1, size, ms)
            pieces.strong += radio.strong()

    def _tell(self, ms):
        self.board.feed()
        self._health_ms = ticks_add(ms, _HEALTH_MS)
        reports.health(self)
        for k in range(len(self._ids)):
            pieces = self._pieces[k]
            pieces.turn(ms)
            struct.pack_into(
                SIGNAL_FORMAT,
                self.outbox.note(),
                PAYLOAD,
                ticks_us(),
                self._ids[k],
                pieces.frames,
                pieces.lost,
                pieces.heard,
                pieces.twice,
                pieces.strong,
                0,
                pieces.dropped & 0xFFFF,
            )
            self.outbox.post(SIGNAL, SIGNAL_SIZE)
        self.link.turn()
        if ticks_diff(ms, self._hello_ms) >= 0:
            self._hello_ms = ticks_add(ms, _HELLO_MS)
            reports.hello(self)

    def _requested(self, frame: FrameReader, received_us):
        """What is for this board is answered, what is for a node behind it waits for its next packet."""
        if frame.node not in self._ids:
            self.commands.handle(frame, received_us)
        if frame.node in self._ids or not frame.node:
            raw = self._request.raw
            for i in range(BODY, PAYLOAD + frame.size):
                raw[i] = frame.raw[i]
            end = seal(raw, PAYLOAD + frame.size)
            for pipe in range(len(self._ids)):
                if not frame.node or self._ids[pipe] == frame.node:
                    self._answer(pipe, end)

    def _answer(self, pipe, end):
        """Queues raw[START:end] of the request for a node, in packets."""
        radio, ms = self._radio, ticks_ms()
        if radio.status() & TX_FULL and ticks_diff(ms, self._unfetched_ms) >= 0:
            radio.unqueue()
            self._unfetched_ms = ticks_add(ms, _UNFETCHED_MS)
        at = START
        while at < end:
            if radio.status() & TX_FULL:
                self._pieces[pipe].dropped += 1
                return
            size = end - at if end - at < MOST else MOST
            for i in range(size):
                radio.out[1 + i] = self._request.raw[at + i]
            radio.answer(pipe + 1, size)
            at += size
