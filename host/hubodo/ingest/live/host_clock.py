"""Monitoring of the recording computer's clocks: unset or stepped wall clock, suspension of the process."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from hubodo.recording import Event
from hubodo.units import NS_PER_S

EARLIEST_PLAUSIBLE_NS = 1_704_067_200 * NS_PER_S  # 2024-01-01; this software is newer
MIN_CLOCK_STEP_NS = NS_PER_S // 10  # NTP slews smaller corrections
MIN_SUSPENSION_NS = 5 * NS_PER_S  # longer than any iteration of the loop on a busy computer
_CHECK_PERIOD_NS = NS_PER_S // 2
_MAX_READ_SPAN_NS = NS_PER_S // 100  # a longer pair of readings means that the process was interrupted
_TIMESYNC_FOLDER = Path("/run/systemd/timesync")


class ClockState(StrEnum):
    """Synchronisation state of the wall clock."""

    SYNCHRONISED = "synchronised"
    UNSYNCHRONISED = "unsynchronised"
    UNSET = "unset"
    UNKNOWN = "unknown"


def clock_state(wall_ns: int, timesync: Path = _TIMESYNC_FOLDER) -> ClockState:
    """Return the state of a wall clock from its time and systemd-timesyncd; timesync: its folder."""
    if wall_ns < EARLIEST_PLAUSIBLE_NS:
        return ClockState.UNSET
    if not timesync.is_dir():
        return ClockState.UNKNOWN
    return ClockState.SYNCHRONISED if (timesync / "synchronized").exists() else ClockState.UNSYNCHRONISED


class Clocks(Protocol):
    """The clocks of a computer."""

    def now_ns(self) -> int: ...

    def wall_ns(self) -> int: ...

    def clock_state(self) -> ClockState: ...


class HostClock:
    """A monitor of the computer's clocks; the time axis of the log itself never steps.

    The wall clock is compared with that axis: their difference changes only when the clock is set. An
    iteration of the loop longer than 5 s means that the process did not run.
    """

    def __init__(self, computer: Clocks) -> None:
        self._computer = computer
        self._state = ClockState.UNKNOWN
        self._last_ns = computer.now_ns()
        self._next_ns = 0
        self._initial_offset_ns = self._offset_ns = self._read_offset() or 0

    @property
    def metadata(self) -> Mapping[str, str]:
        """Metadata record `clock` of the log; empty while the state is unknown and no step occurred."""
        correction_ns = self._offset_ns - self._initial_offset_ns
        if self._state == ClockState.UNKNOWN and not correction_ns:
            return {}
        return {"state": self._state.value, "utc_minus_log_s": f"{correction_ns / NS_PER_S:.3f}"}

    def tick(self, now_ns: int) -> Iterator[Event]:
        """Yield the events since the last call; to be called in each iteration of the loop."""
        last_ns, self._last_ns = self._last_ns, now_ns
        if now_ns - last_ns > MIN_SUSPENSION_NS:
            yield self._suspension_event(last_ns, now_ns)
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + _CHECK_PERIOD_NS
        offset_ns = self._read_offset()
        if offset_ns is not None and abs(offset_ns - self._offset_ns) > MIN_CLOCK_STEP_NS:
            step_ns, self._offset_ns = offset_ns - self._offset_ns, offset_ns
            yield self._step_event(now_ns, step_ns)
        if self._state not in (ClockState.SYNCHRONISED, self._computer.clock_state()):
            self._state = self._computer.clock_state()
            yield self._state_event(now_ns)

    def _read_offset(self) -> int | None:
        """Return wall clock minus log time, ns; None if the process was interrupted between readings."""
        before_ns = self._computer.now_ns()
        wall_ns = self._computer.wall_ns()
        after_ns = self._computer.now_ns()
        return wall_ns - before_ns if after_ns - before_ns < _MAX_READ_SPAN_NS else None

    def _suspension_event(self, start_ns: int, end_ns: int) -> Event:
        seconds = (end_ns - start_ns) / NS_PER_S
        text = (
            f"the recorder did not run for {seconds:.1f} s: the computer was suspended, or the process "
            "stopped; data sent by nodes meanwhile may be lost: see the gaps"
        )
        return Event(end_ns, "clock", "computer", text, {"standstill_s": seconds, "begin_ns": start_ns})

    def _step_event(self, now_ns: int, step_ns: int) -> Event:
        step, correction = step_ns / NS_PER_S, (self._offset_ns - self._initial_offset_ns) / NS_PER_S
        direction, sign = "forward" if step > 0 else "back", "+" if correction >= 0 else "-"
        text = (
            f"the computer's clock was set {direction} by {abs(step):.3f} s; this log continues without a "
            f"step: UTC is log time {sign} {abs(correction):.3f} s"
        )
        return Event(now_ns, "clock", "computer", text, {"step_s": step, "utc_minus_log_s": correction})

    def _state_event(self, now_ns: int) -> Event:
        shown = datetime.fromtimestamp(self._computer.wall_ns() / NS_PER_S, UTC).strftime("%Y-%m-%d %H:%M")
        text = {
            ClockState.UNSET: f"the computer's clock is not set, it shows {shown}: times and names of logs "
            "are not UTC; set it, or wait for NTP",
            ClockState.UNSYNCHRONISED: f"the computer's clock, which shows {shown} UTC, has not been "
            "synchronised since the start: times and names of logs may be off",
        }.get(self._state, f"the computer's clock is {self._state.value}")
        return Event(now_ns, "clock", "computer", text, {"state": self._state.value})
