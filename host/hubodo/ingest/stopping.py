"""SIGINT and SIGTERM as a wish to stop, so that files are closed and ports given back."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def stop_on_signals(stopping: threading.Event) -> Iterator[threading.Event]:
    """Sets `stopping` instead of ending the process.

    Only the main thread may ask for that; in another one this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield stopping
        return

    def end(number: int, frame: FrameType | None) -> None:
        stopping.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stopping
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
