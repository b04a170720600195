"""Signal handling of a recording: SIGINT and SIGTERM stop it, SIGHUP starts a new log."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def exit_on_ctrl_c() -> Iterator[None]:
    """Exit with one line and code 130 on ctrl-C while modules are imported, instead of a traceback."""
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
def exit_after_timeout(timeout_s: float | None, code: int) -> Iterator[None]:
    """Exit the process with `code` when the block takes longer than `timeout_s`; None: no limit.

    Used for the final output of a recording: the log is closed, and a blocked reader must not keep the ports.
    """
    if timeout_s is None:
        yield
        return
    timer = threading.Timer(timeout_s, os._exit, (code,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextmanager
def stop_on_signals(
    stop_requested: threading.Event, rotate_requested: threading.Event | None = None
) -> Iterator[threading.Event]:
    """Set `stop_requested` on SIGINT and SIGTERM, and `rotate_requested`, if given, on SIGHUP.

    Once the controlling terminal is closed, SIGHUP requests a stop, or is ignored if it was ignored before,
    as by nohup. Only the main thread can handle signals; in other threads this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield stop_requested
        return

    def end(number: int, frame: FrameType | None) -> None:
        stop_requested.set()

    in_terminal, ignored = rotate_requested is not None and _has_terminal(), _hangup_ignored()

    def hang_up(number: int, frame: FrameType | None) -> None:
        assert rotate_requested is not None
        if not in_terminal or _has_terminal():
            rotate_requested.set()
        elif not ignored:
            stop_requested.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    hangup = getattr(signal, "SIGHUP", None)
    if rotate_requested is not None and hangup is not None:
        before[hangup] = signal.signal(hangup, hang_up)
    try:
        yield stop_requested
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
