"""Signals that stop a recording or start another log, and their handlers before and after."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from hubodo.ingest import stop_signals
from hubodo.ingest.stop_signals import exit_after_timeout, exit_on_ctrl_c, stop_on_signals

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def _in_process(code: str) -> subprocess.CompletedProcess[str]:
    program = "import os, signal, threading, time\nfrom hubodo.ingest.stop_signals import *\n" + code
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_sigterm_request_a_stop_and_the_handlers_before_are_restored(
    number: signal.Signals,
) -> None:
    before = [signal.getsignal(it) for it in SIGNALS]
    stop, rotate = threading.Event(), threading.Event()
    with stop_on_signals(stop, rotate):
        signal.raise_signal(number)
        assert stop.is_set() and not rotate.is_set()
    assert [signal.getsignal(it) for it in SIGNALS] == before


@pytest.mark.parametrize(
    ("terminal_at_start", "terminal_now", "ignored", "rotates", "stops"),
    [
        (False, False, False, True, False),
        (True, True, False, True, False),
        (True, False, False, False, True),
        (True, False, True, False, False),
    ],
)
def test_a_hangup_starts_another_log_unless_the_terminal_was_closed(
    monkeypatch: pytest.MonkeyPatch,
    terminal_at_start: bool,
    terminal_now: bool,
    ignored: bool,
    rotates: bool,
    stops: bool,
) -> None:
    """A closed terminal stops a recording, unless nohup made it ignore the hangup."""
    monkeypatch.setattr(stop_signals, "_has_terminal", lambda: terminal_at_start)
    monkeypatch.setattr(stop_signals, "_hangup_ignored", lambda: ignored)
    stop, rotate = threading.Event(), threading.Event()
    with stop_on_signals(stop, rotate):
        monkeypatch.setattr(stop_signals, "_has_terminal", lambda: terminal_now)
        signal.raise_signal(signal.SIGHUP)
    assert (rotate.is_set(), stop.is_set()) == (rotates, stops)


def test_outside_the_main_thread_no_handler_is_installed() -> None:
    before, during = signal.getsignal(signal.SIGINT), []

    def run() -> None:
        with stop_on_signals(threading.Event(), threading.Event()), exit_on_ctrl_c():
            during.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert during == [before]


def test_ctrl_c_during_the_start_is_one_line_and_code_130() -> None:
    done = _in_process(
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "with exit_on_ctrl_c():\n    signal.raise_signal(signal.SIGINT)\n"
    )
    assert done.returncode == 130
    assert done.stderr == "hubodo: interrupted while starting; nothing was written\n"


def test_an_ignored_ctrl_c_stays_ignored_during_the_start() -> None:
    done = _in_process(
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "with exit_on_ctrl_c():\n    signal.raise_signal(signal.SIGINT)\nprint('on')\n"
    )
    assert (done.returncode, done.stdout) == (0, "on\n")


def test_output_that_blocks_ends_the_process_with_the_code_and_a_quick_one_does_not() -> None:
    done = _in_process("with exit_after_timeout(0.05, 3):\n    time.sleep(60)\n")
    assert done.returncode == 3
    with exit_after_timeout(60.0, 3), exit_after_timeout(None, 4):
        pass
    timers = [thread for thread in threading.enumerate() if isinstance(thread, threading.Timer)]
    assert all(timer.finished.is_set() for timer in timers)
