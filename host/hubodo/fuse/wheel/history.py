"""Ring buffer of step records, shared by rollback, fixed-lag smoothing and whole-log smoothing."""

from __future__ import annotations

from collections import deque

from hubodo.fuse.wheel.records import StepRecord


class History:
    """The newest step records, and how many of them can be replayed.

    A replay restores the states at the start of a step and processes the windows since then again. It
    reproduces only what the windows themselves do, so any other change of the state is a barrier.
    """

    def __init__(self, n_steps: int) -> None:
        self._records: deque[StepRecord] = deque(maxlen=n_steps)
        self._n_replayable = 0

    def append(self, record: StepRecord) -> None:
        """Add the newest step."""
        self._records.append(record)
        self._n_replayable = min(self._n_replayable + 1, len(self._records))

    def replace_newest(self, record: StepRecord) -> None:
        """Complete the newest record at the end of its step."""
        self._records[-1] = record

    def set_barrier(self) -> None:
        """Exclude all steps so far from a replay."""
        self._n_replayable = 0

    @property
    def newest(self) -> StepRecord:
        """Return the newest record."""
        return self._records[-1]

    @property
    def is_replayable(self) -> bool:
        """Return True if at least the newest step can be replayed."""
        return self._n_replayable > 0

    @property
    def first_replayable(self) -> int:
        """Return the window number of the oldest step that can be replayed."""
        return self._records[-self._n_replayable].number

    def pop_since(self, number: int) -> list[StepRecord]:
        """Remove and return the replayable records from window `number` on, oldest first."""
        popped: list[StepRecord] = []
        while self._n_replayable and self._records[-1].number >= number:
            popped.append(self._records.pop())
            self._n_replayable -= 1
        return popped[::-1]
