"""SIGINT and SIGTERM as a wish to stop, so that files are closed and ports given back; SIGHUP for anew."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def one_line_on_ctrl_c() -> Iterator[None]:
    """While modules load, ctrl-C is one line and exit code 130: an exception would come up inside of them."""
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        os.write(2, b"hubodo: interrupted while starting; nothing was written\n")
        os._exit(130)

    signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def exit_when_unread(seconds: float | None, code: int) -> Iterator[None]:
    """End the process with `code` when the block takes longer than `seconds`; None: however long it takes.

    For the last words of a recording: the log is closed, and a reader that hangs must not keep the ports.
    """
    if seconds is None:
        yield
        return
    timer = threading.Timer(seconds, os._exit, (code,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextmanager
def stop_on_signals(
    stopping: threading.Event, again: threading.Event | None = None
) -> Iterator[threading.Event]:
    """Sets `stopping` instead of ending the process, and with `again` that on SIGHUP, where there is one.

    Once the terminal has gone, a SIGHUP is a wish to stop, or is ignored where it was before, as by nohup.

    Only the main thread may ask for that; in another one this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield stopping
        return

    def end(number: int, frame: FrameType | None) -> None:
        stopping.set()

    in_terminal, ignored = again is not None and _has_terminal(), _hangup_ignored()

    def hang_up(number: int, frame: FrameType | None) -> None:
        assert again is not None
        if not in_terminal or _has_terminal():
            again.set()
        elif not ignored:
            stopping.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    hangup = getattr(signal, "SIGHUP", None)
    if again is not None and hangup is not None:
        before[hangup] = signal.signal(hangup, hang_up)
    try:
        yield stopping
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _has_terminal() -> bool:
    try:
        os.close(os.open("/dev/tty", os.O_RDWR))
    except OSError:
        return False
    return True


def _hangup_ignored() -> bool:
    hangup = getattr(signal, "SIGHUP", None)
    return hangup is not None and signal.getsignal(hangup) is signal.SIG_IGN
