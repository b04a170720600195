"""select of the virtual board: waiting for input costs the board's time, and no processor of the host's."""

# MicroPython's own types: not the host's code, no host types.
# mypy: ignore-errors

import sys
from select import POLLERR, POLLHUP, POLLIN, POLLOUT  # noqa: F401
from select import poll as _Poll
from time import sleep_us

import _board

_wait_input = _board.wait_input
_STEP_US = 500


class poll:
    """One stream; more than one would each have to be waited for."""

    def __init__(self):
        self._poll = _Poll()
        self._stream = None

    def register(self, stream, flags=POLLIN | POLLOUT):
        self._poll.register(stream, flags)
        self._stream = stream

    def ipoll(self, timeout=-1, flags=0):
        if timeout and self._stream is sys.stdin:
            _wait_input(timeout)
        elif timeout > 0:
            for _ in range(timeout * 1000 // _STEP_US):
                if self._stream.any():
                    break
                sleep_us(_STEP_US)
        return self._poll.ipoll(0, flags)
