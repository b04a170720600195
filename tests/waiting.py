"""Wait in tests for a condition, never for a fixed time."""

import time
from collections.abc import Callable


def until(condition: Callable[[], object]) -> None:
    """Wait until the condition is true, however busy the machine; fail after five minutes."""
    end = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < end, "the condition stayed false"
        time.sleep(0.02)
