"""A view in a thread: order of its calls, and what a blocked terminal costs."""

import threading

from hubodo.ingest.live import view_thread
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.view_thread import TERMINAL_PART, ViewThread

SNAPSHOT = object()


class Terminal:
    """A view that records its calls; show_notice waits for `released`."""

    def __init__(self) -> None:
        self.calls: list[object] = []
        self.blocked, self.released, self.finished = (threading.Event() for _ in range(3))
        self.released.set()

    def __enter__(self) -> "Terminal":
        self.calls.append("enter")
        return self

    def __exit__(self, *_: object) -> None:
        self.calls.append("exit")

    def show_notice(self, notice: object) -> None:
        self.blocked.set()
        self.released.wait(300.0)
        self.calls.append(notice)
        if notice == "last":
            self.finished.set()

    def show(self, snapshot: object) -> None:
        self.calls.append(snapshot)


def _view(terminal: Terminal) -> tuple[ViewThread, Bulkheads]:
    bulkheads = Bulkheads(lambda: 0)
    return ViewThread(terminal, bulkheads), bulkheads  # type: ignore[arg-type]


def test_calls_arrive_in_order_before_the_view_is_closed() -> None:
    terminal = Terminal()
    with _view(terminal)[0] as view:
        view.show_notice("starting")
        view.show(SNAPSHOT)  # type: ignore[arg-type]
        view.show_notice("done")
    assert terminal.calls == ["enter", "starting", SNAPSHOT, "done", "exit"]


def test_a_blocked_terminal_delays_nobody_and_snapshots_are_skipped_for_notices() -> None:
    terminal = Terminal()
    terminal.released.clear()
    with _view(terminal)[0] as view:
        view.show_notice("first")
        assert terminal.blocked.wait(300.0)
        for _ in range(200):
            view.show(SNAPSHOT)  # type: ignore[arg-type]
        view.show_notice("last")
        terminal.released.set()
    assert terminal.calls.count(SNAPSHOT) == view_thread._MAX_WAITING_FOR_SNAPSHOT
    assert terminal.calls[-2:] == ["last", "exit"]


def test_lines_that_a_blocked_terminal_dropped_are_counted_once() -> None:
    terminal = Terminal()
    terminal.released.clear()
    with _view(terminal)[0] as view:
        view.show_notice("first")
        assert terminal.blocked.wait(300.0)
        for k in range(view_thread._MAX_WAITING_LINES + 4):
            view.show_notice(k)  # type: ignore[arg-type]
        view.show_notice("last")
        terminal.released.set()
        assert terminal.finished.wait(300.0)
    counted = [call for call in terminal.calls if isinstance(call, str) and "dropped" in call]
    assert len(counted) == 1 and counted[0].startswith("5 lines were dropped")
    assert terminal.calls[-3:] == [view_thread._MAX_WAITING_LINES + 3, "last", "exit"]


def test_a_terminal_that_fails_is_a_fault_of_the_terminal_alone() -> None:
    class Closed(Terminal):
        def show_notice(self, notice: object) -> None:
            raise BrokenPipeError("pipe")

    view, bulkheads = _view(Closed())
    with view:
        view.show_notice("x")
    assert bulkheads.fault_counts() == {TERMINAL_PART: 1}
