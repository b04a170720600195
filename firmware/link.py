"""Base class of the links to the host, and USB; what a stream does not accept stays in the outbox."""

import select
import sys
from time import sleep_ms

import micropython
from framing import START, FrameReader
from micropython import const

_WHOLE = const(256)
_SENDS_PER_TURN = const(4)
_READS_PER_TURN = const(32)
_WAIT_STEP_MS = const(2)
_CTRL_C = const(3)
_SLICES = sys.implementation.name != "micropython"


def _write(stream, raw, at, size):
    """Write raw[at:at + size], without allocation on a board; return the number of accepted bytes or None."""
    if _SLICES:
        return stream.write(memoryview(raw)[at : at + size])
    return stream.write(raw, at, size)


class Link:
    """Base class of links. A subclass defines `_accept`, bytes accepted, and `_byte`, the next byte or -1."""

    limit = _WHOLE
    """Largest number of bytes offered to the stream at once."""
    ON_CONSOLE = False
    """True if frames share the console with the REPL, so that ctrl-C must be an ordinary byte."""

    def __init__(self):
        self.reader = FrameReader()
        self._readable = None
        """Poll object of a stream that can be waited for; others are checked every 2 ms."""

    def wait(self, ms):
        """Sleep for `ms`, or until a byte arrives from the host."""
        if self._readable is None:
            sleep_ms(ms if ms < _WAIT_STEP_MS else _WAIT_STEP_MS)
        else:
            self._readable(ms)

    def sleep(self, ms):
        """Wait for `ms`, or less, with the processor asleep where the link allows that."""
        self.wait(ms)

    def send(self, outbox):
        """Offer frames of the queue to the stream, four per call at most."""
        turns = _SENDS_PER_TURN
        while outbox.count and turns:
            turns -= 1
            slot = outbox.oldest()
            at = START + outbox.sent
            size = slot.end - at
            accepted = self._accept(slot.raw, at, size if size < self.limit else self.limit)
            if not accepted:
                return
            outbox.advance(accepted)

    def _accept(self, raw, at, size):
        raise NotImplementedError

    def _byte(self):
        raise NotImplementedError

    def receive(self):
        """Return True when a frame from the host is complete: it is in `reader` until the next call."""
        for _ in range(_READS_PER_TURN):
            byte = self._byte()
            if byte < 0:
                return False
            if self.reader.feed(byte):
                return True
        return False

    def step(self):
        """Maintain the carrier of the link; may block when there is none."""

    def close(self):
        """Release the stream."""


class UsbLink(Link):
    """USB CDC, shared with the REPL: ctrl-C is an ordinary byte until `close`.

    The driver blocks when its buffer is full, and drops bytes after half a second: hence single bytes while
    the host does not keep up, doubling to whole frames once it does.
    """

    ON_CONSOLE = True
    CHUNK = _WHOLE
    """`limit` while the host keeps up."""

    def __init__(self):
        super().__init__()
        self.limit = self.CHUNK
        self._in = sys.stdin.buffer
        self._out = sys.stdout.buffer
        self._one = bytearray(1)
        self._readable = _poll(sys.stdin, select.POLLIN)
        self._writable = _poll(sys.stdout, select.POLLOUT)
        micropython.kbd_intr(-1)

    def _accept(self, raw, at, size):
        if not _ready(self._writable, select.POLLOUT):
            self.limit = 1
            return 0
        if self.limit < self.CHUNK:
            self.limit <<= 1
        return _write(self._out, raw, at, size)

    def _byte(self):
        if _ready(self._readable, select.POLLIN) and self._in.readinto(self._one):
            return self._one[0]
        return -1

    def close(self):
        micropython.kbd_intr(_CTRL_C)


def _poll(stream, event):
    """Return a poll method for `_ready`: MicroPython's ipoll, which does not allocate, where it exists."""
    poll = select.poll()
    poll.register(stream, event)
    return poll.ipoll if hasattr(poll, "ipoll") else poll.poll


def _ready(poll, event):
    for item in poll(0):
        if item[1] & event:
            return True
    return False
