"""MicroPython's module select of the virtual board: a wait for input takes board time, not host CPU time."""

# Runs in MicroPython: without type annotations.
# mypy: ignore-errors

from select import POLLERR, POLLHUP, POLLIN, POLLOUT  # noqa: F401
from select import poll as _Poll

import _board

_wait_input = _board.wait_input


class poll:
    """A poll object; it waits itself for standard input only, and leaves other streams to MicroPython."""

    def __init__(self):
        self._poll = _Poll()
        self._input_only = True

    def register(self, stream, flags=POLLIN | POLLOUT):
        self._poll.register(stream, flags)
        self._input_only = self._input_only and flags == POLLIN

    def unregister(self, stream):
        self._poll.unregister(stream)

    def modify(self, stream, flags):
        self._poll.modify(stream, flags)

    def poll(self, timeout=-1):
        return self._poll.poll(self._wait_for_input(timeout))

    def ipoll(self, timeout=-1, flags=0):
        return self._poll.ipoll(self._wait_for_input(timeout), flags)

    def _wait_for_input(self, timeout):
        """Wait for standard input; return the remaining timeout, ms."""
        if timeout and self._input_only:
            while _wait_input(timeout):
                pass
            return 0
        return timeout
