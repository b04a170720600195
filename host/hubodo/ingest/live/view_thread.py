"""The view of a recording in a thread of its own, so that a blocked terminal delays nothing."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.output_thread import OutputThread
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.ingest.live.view import View
from hubodo.recording import Event

TERMINAL_PART = "terminal"
_MAX_WAITING_LINES = 4096
_MAX_WAITING_FOR_SNAPSHOT = 64
"""Queue length beyond which snapshots are skipped, so that notices are not dropped for them."""


class ViewThread:
    """A `View` that forwards all calls to another view in a thread."""

    def __init__(self, view: View, bulkheads: Bulkheads) -> None:
        self._view = view
        self._dropped_reported = 0
        self._thread: OutputThread[Callable[[], object]] = OutputThread(
            TERMINAL_PART, lambda: lambda action: action(), bulkheads, capacity=_MAX_WAITING_LINES
        )

    def __enter__(self) -> Self:
        self._thread.put(self._view.__enter__)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.put(lambda: self._view.__exit__(kind, error, trace))
        self._thread.close()

    def show_notice(self, notice: Event | str) -> None:
        """Show one line permanently."""
        self._thread.put(lambda: self._show_notice(notice))

    def show(self, snapshot: Snapshot) -> None:
        """Show the present status; to be called about once per second."""
        if self._thread.waiting_count < _MAX_WAITING_FOR_SNAPSHOT:
            self._thread.put(lambda: self._view.show(snapshot))

    def _show_notice(self, notice: Event | str) -> None:
        dropped = self._thread.dropped
        if dropped > self._dropped_reported:
            self._view.show_notice(
                f"{dropped - self._dropped_reported} lines were dropped because the output was not read"
            )
            self._dropped_reported = dropped
        self._view.show_notice(notice)
