"""MicroPython's module gc of the virtual board: mem_free is that of the heap of the board."""

# Runs in MicroPython: without type annotations.
# mypy: ignore-errors

from gc import collect, disable, enable, isenabled, mem_alloc  # noqa: F401

import _board

_heap = _board.heap_bytes()


def mem_free():
    return _heap - mem_alloc()


def threshold(amount=-1):
    return -1
