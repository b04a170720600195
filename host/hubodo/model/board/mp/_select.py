"""select of the virtual board: waiting for input costs the board's time, and no processor of the host's."""

# MicroPython's own types: not the host's code, no host types.
# mypy: ignore-errors

from select import POLLERR, POLLHUP, POLLIN, POLLOUT  # noqa: F401
from select import poll as _Poll

import _board

_wait_input = _board.wait_input


class poll:
    """Standard input is what can be waited for."""

    def __init__(self):
        self._poll = _Poll()

    def register(self, stream, flags=POLLIN | POLLOUT):
        self._poll.register(stream, flags)

    def ipoll(self, timeout=-1, flags=0):
        if timeout:
            _wait_input(timeout)
        return self._poll.ipoll(0, flags)
