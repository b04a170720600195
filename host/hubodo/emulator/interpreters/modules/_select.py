"""select of the virtual board: waiting for input costs the board's time, and no processor of the host's."""

# MicroPython's own types: not the host's code, no host types.
# mypy: ignore-errors

from select import POLLERR, POLLHUP, POLLIN, POLLOUT  # noqa: F401
from select import poll as _Poll

import _board

_wait_input = _board.wait_input


class poll:
    """Its own waiting is for standard input alone; for anything else MicroPython waits."""

    def __init__(self):
        self._poll = _Poll()
        self._input_alone = True

    def register(self, stream, flags=POLLIN | POLLOUT):
        self._poll.register(stream, flags)
        self._input_alone = self._input_alone and flags == POLLIN

    def unregister(self, stream):
        self._poll.unregister(stream)

    def modify(self, stream, flags):
        self._poll.modify(stream, flags)

    def poll(self, timeout=-1):
        return self._poll.poll(self._left(timeout))

    def ipoll(self, timeout=-1, flags=0):
        return self._poll.ipoll(self._left(timeout), flags)

    def _left(self, timeout):
        if timeout and self._input_alone:
            while _wait_input(timeout):
                pass
            return 0
        return timeout
