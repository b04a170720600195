"""gc of the virtual board: mem_free is what the board's heap has left, not what WebAssembly could grow to."""

# MicroPython's own types: not the host's code, no host types.
# mypy: ignore-errors

from gc import collect, disable, enable, isenabled, mem_alloc  # noqa: F401

import _board

_heap = _board.heap_bytes()


def mem_free():
    return _heap - mem_alloc()


def threshold(amount=-1):
    return -1
