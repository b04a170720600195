"""A receiver board: forwards frames of radio nodes to the host, and requests to the nodes."""

import struct
from time import ticks_add, ticks_diff, ticks_ms, ticks_us

import reports
from commands import Commands
from framing import BODY, PAYLOAD, FrameReader, seal
from micropython import const
from outbox import Outbox, Slot
from wire_more import SIGNAL, SIGNAL_FORMAT, SIGNAL_SIZE

_HELLO_MS = const(5000)
_HEALTH_MS = const(1000)
_FAREWELL_MS = const(300)
_UNKNOWN_US = const(65535)


class _NoSensors:
    """Stands in for parts and sampler of a board without sensors, for `reports` and `commands`."""

    chip = mag = None
    faults = i2c_errors = recoveries = failures = overruns = missed = batch = 0
    chips = ()

    def __init__(self):
        self.clock = self

    def bound_us(self):
        return _UNKNOWN_US


class Receiver:
    """One receiver on one board. `step` runs the loop once; `leave` is set to a RebootMode to end it."""

    def __init__(self, board, link):
        self.board, self.link, self.settings = board, link, board.settings
        self.outbox = Outbox(self.settings["queue"], self.settings["node_id"])
        self.parts = self.sampler = _NoSensors()
        self.commands = Commands(self)
        self.leave = None
        self.free_heap = self.longest_us = 0
        self.estimator = self.init = None
        self._air = _open_air(board, self.outbox)
        self._request = Slot()
        self._hello_ms = self._health_ms = ticks_ms()
        reports.hello(self)

    def step(self):
        """Run the loop once: receive, forward, handle requests, report every second."""
        now = ticks_us()
        ms = ticks_ms()
        received = self._air.receive(ms)
        if self.outbox.count:
            self.link.send(self.outbox)
        if self.link.receive():
            self._requested(self.link.reader, ticks_us())
            self.link.send(self.outbox)
        if ticks_diff(ms, self._health_ms) >= 0:
            self._report(ms)
        took = ticks_diff(ticks_us(), now)
        if took > self.longest_us:
            self.longest_us = took
        if not received:
            self.link.wait(1)

    def start(self):
        """Do nothing: a receiver has no sensors, which `commands` reports."""

    def stop(self):
        """Do nothing: a receiver has no sensors."""

    def new_filter(self):
        """Do nothing: a receiver has no filter."""

    def farewell(self):
        """Give the link up to 0.3 s to send the frames in the queue."""
        until = ticks_add(ticks_ms(), _FAREWELL_MS)
        while self.outbox.count and ticks_diff(until, ticks_ms()) > 0:
            self.link.send(self.outbox)
            self.board.feed()
            self.link.wait(1)

    def _report(self, ms):
        self.board.feed()
        self._health_ms = ticks_add(ms, _HEALTH_MS)
        reports.health(self)
        air = self._air
        air.step(ms)
        for k in range(len(air.ids)):
            node = air.nodes[k]
            struct.pack_into(
                SIGNAL_FORMAT,
                self.outbox.note(),
                PAYLOAD,
                ticks_us(),
                air.ids[k],
                node.frames,
                node.lost,
                node.received,
                node.repeated,
                node.strong,
                0,
                node.dropped & 0xFFFF,
            )
            self.outbox.post(SIGNAL, SIGNAL_SIZE)
        self.link.step()
        if ticks_diff(ms, self._hello_ms) >= 0:
            self._hello_ms = ticks_add(ms, _HELLO_MS)
            reports.hello(self)

    def _requested(self, frame: FrameReader, received_us):
        """Answer requests to this board; forward those to its nodes."""
        ids = self._air.ids
        if frame.node not in ids:
            self.commands.handle(frame, received_us)
        if frame.node in ids or not frame.node:
            raw = self._request.raw
            for i in range(BODY, PAYLOAD + frame.size):
                raw[i] = frame.raw[i]
            end = seal(raw, PAYLOAD + frame.size)
            for k in range(len(ids)):
                if not frame.node or ids[k] == frame.node:
                    self._air.answer(k, raw, end)


def _open_air(board, outbox):
    """Return the receiving side of the radio that the settings name."""
    if board.settings["receiver"] == "espnow":
        from radio import espnow_air

        return espnow_air.EspNowAir(board, outbox)
    from radio import nrf24_air

    return nrf24_air.Nrf24Air(board, outbox)
