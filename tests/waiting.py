"""Waiting in tests: for what happens, never for the clock."""

import time
from collections.abc import Callable


def until(happened: Callable[[], object]) -> None:
    """However long it takes on a busy machine; fails where it is as good as certain that it never will."""
    end = time.monotonic() + 300
    while not happened():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)
