"""The byte streams to the host, and USB; what a stream does not take at once stays in the outbox."""

import select
import sys
from time import sleep_ms

import micropython
from framing import START, FrameReader
from micropython import const

_WHOLE = const(256)
_SENDS_PER_TURN = const(4)
_READS_PER_TURN = const(32)
_LOOK_MS = const(2)
_CTRL_C = const(3)
_SLICES = sys.implementation.name != "micropython"


def _write(stream, raw, at, size):
    """How many bytes of raw[at:at + size] the stream took, or None; MicroPython's streams need no slice."""
    if _SLICES:
        return stream.write(memoryview(raw)[at : at + size])
    return stream.write(raw, at, size)


class Link:
    """What every link does; a link adds how much of raw[at:at + size] it took, and the next byte or -1."""

    MOST = _WHOLE
    """Bytes offered to the stream at once."""
    ON_CONSOLE = False
    """Whether frames travel where the REPL is, so that ctrl-C must be an ordinary byte."""

    def __init__(self):
        self.reader = FrameReader()
        self._readable = None
        """Of a stream that can be waited for: its poll for input; another is looked at every other ms."""

    def wait(self, ms):
        """Sleeps so long, or until a byte comes from the host."""
        if self._readable is None:
            sleep_ms(ms if ms < _LOOK_MS else _LOOK_MS)
        else:
            self._readable(ms)

    def send(self, outbox):
        """Offers waiting frames to the stream, some of them at most."""
        turns = _SENDS_PER_TURN
        while outbox.count and turns:
            turns -= 1
            slot = outbox.oldest()
            at = START + outbox.sent
            size = slot.end - at
            taken = self._take(slot.raw, at, size if size < self.MOST else self.MOST)
            if not taken:
                return
            outbox.took(taken)

    def _take(self, raw, at, size):
        raise NotImplementedError

    def _byte(self):
        raise NotImplementedError

    def receive(self):
        """True when a frame from the host has come: it stands in `reader` until the next call."""
        for _ in range(_READS_PER_TURN):
            byte = self._byte()
            if byte < 0:
                return False
            if self.reader.feed(byte):
                return True
        return False

    def turn(self):
        """Looks after the carrier of the link; may take its time when there is none."""

    def close(self):
        """Gives the stream back."""


class UsbLink(Link):
    """USB CDC, shared with the REPL: ctrl-C is an ordinary byte until `close`.

    The driver waits when more is written than fits, and drops after half a second: hence single bytes while
    the host does not keep up, and whole frames again as it does.
    """

    ON_CONSOLE = True
    CHUNK = _WHOLE
    """MOST of a host that keeps up."""

    def __init__(self):
        super().__init__()
        self.MOST = self.CHUNK
        self._in = sys.stdin.buffer
        self._out = sys.stdout.buffer
        self._one = bytearray(1)
        self._readable = _poll(sys.stdin, select.POLLIN)
        self._writable = _poll(sys.stdout, select.POLLOUT)
        micropython.kbd_intr(-1)

    def _take(self, raw, at, size):
        if not _ready(self._writable, select.POLLOUT):
            self.MOST = 1
            return 0
        if self.MOST < self.CHUNK:
            self.MOST <<= 1
        return _write(self._out, raw, at, size)

    def _byte(self):
        if _ready(self._readable, select.POLLIN) and self._in.readinto(self._one):
            return self._one[0]
        return -1

    def close(self):
        micropython.kbd_intr(_CTRL_C)


def _poll(stream, event):
    """Ready, without allocation, with `_ready`: MicroPython's ipoll where it is."""
    poll = select.poll()
    poll.register(stream, event)
    return poll.ipoll if hasattr(poll, "ipoll") else poll.poll


def _ready(poll, event):
    for item in poll(0):
        if item[1] & event:
            return True
    return False
