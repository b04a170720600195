"""The view of a recording on a thread of its own: a terminal that nobody reads holds nothing up."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.output_thread import OutputThread
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.ingest.live.view import View
from hubodo.recording import Event

PART = "terminal"
_CAPACITY = 4096
_CROWDED = 64
"""Items that wait, beyond which no snapshot is added: lines that stay come first."""


class ViewThread:
    """A `View` that passes everything on to another view."""

    def __init__(self, view: View, bulkheads: Bulkheads) -> None:
        self._view = view
        self._reported = 0
        self._thread: OutputThread[Callable[[], object]] = OutputThread(
            PART, lambda: lambda action: action(), bulkheads, capacity=_CAPACITY
        )

    def __enter__(self) -> Self:
        self._thread.put(self._view.__enter__)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.put(lambda: self._view.__exit__(kind, error, trace))
        self._thread.close()

    def say(self, notice: Event | str) -> None:
        """See `View`."""
        self._thread.put(lambda: self._say(notice))

    def show(self, snapshot: Snapshot) -> None:
        """See `View`."""
        if self._thread.waiting < _CROWDED:
            self._thread.put(lambda: self._view.show(snapshot))

    def _say(self, notice: Event | str) -> None:
        dropped = self._thread.dropped
        if dropped > self._reported:
            self._view.say(f"{dropped - self._reported} lines were dropped because nobody read them")
            self._reported = dropped
        self._view.say(notice)
