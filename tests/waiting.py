"""Wait in tests for a condition, never for a fixed time."""

import time
from collections.abc import Callable


def until(happened: Callable[[], object]) -> None:
    """Wait until the condition is true, however busy the machine; fail after five minutes."""
    end = time.monotonic() + 300
    while not happened():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)
