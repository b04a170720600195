"""Scheduled events of a board: scripted faults, watchdog, cable and end of the run."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from hubodo.emulator.board.clock import FOREVER
from hubodo.emulator.board.hypercall import Handler, Op, Reply
from hubodo.emulator.chips.faults import BrownOut, Reset, ScriptedFault, Stall, Unplug
from hubodo.units import NS_PER_S


class EventSchedule:
    """Scheduled events of one board; times in ns since power-on.

    Attributes
    ----------
    end : time at which the board is switched off.
    plug_at : time at which the cable is plugged in again.
    watchdog_at : time at which the watchdog restarts the board unless it is fed.
    """

    def __init__(self, faults: Sequence[ScriptedFault], run_for: float | None) -> None:
        self.end = FOREVER if run_for is None else run_for * NS_PER_S
        self.plug_at = FOREVER
        self.watchdog_at = FOREVER
        self._watchdog_timeout = 0.0
        self._faults = sorted(
            (f for f in faults if isinstance(f, Reset | Unplug) or _restarts(f)), key=lambda f: f.t
        )
        self._stalls = sorted((f for f in faults if isinstance(f, Stall)), key=lambda f: f.t)

    @property
    def next_time(self) -> float:
        """Time of the next event, stalls excluded."""
        scripted = self._faults[0].t * NS_PER_S if self._faults else FOREVER
        return min(self.watchdog_at, self.plug_at, self.end, scripted)

    @property
    def quiet_until(self) -> float:
        """Time of the next event, stalls included."""
        return min(self.next_time, self._stalls[0].t * NS_PER_S if self._stalls else FOREVER)

    def pop_due_fault(self, t: float) -> ScriptedFault | None:
        """Return the next fault that is due at t (reset, brown-out or unplugged cable), or None."""
        if self._faults and self._faults[0].t * NS_PER_S <= t:
            return self._faults.pop(0)
        return None

    def apply_stalls(self, t: float) -> tuple[int, float]:
        """Return the number of stalls that begin by t, and t delayed by them."""
        count = 0
        while self._stalls and self._stalls[0].t * NS_PER_S <= t:
            t += self._stalls.pop(0).seconds * NS_PER_S
            count += 1
        return count, t

    def handlers(self) -> dict[int, Handler]:
        """Return the handlers of the calls served here."""
        return {Op.WDT: self._watchdog}

    def _watchdog(self, argument: int, payload: bytes, t: float) -> Reply:
        """Feed the watchdog, or start it with a timeout."""
        if argument:
            self._watchdog_timeout = struct.unpack("<I", payload)[0] * 1e6
        if self._watchdog_timeout:
            self.watchdog_at = t + self._watchdog_timeout
        return Reply(t)

    def stop_watchdog(self) -> None:
        """Stop the watchdog, as at a restart of the processor."""
        self.watchdog_at, self._watchdog_timeout = FOREVER, 0.0


def _restarts(fault: ScriptedFault) -> bool:
    """Return True if a fault restarts the processor."""
    return isinstance(fault, BrownOut) and fault.affected == "board"
