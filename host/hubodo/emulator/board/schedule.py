"""What happens to a board at which time: scripted faults, its watchdog, its cable, its end."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from hubodo.emulator.board.clock import FOREVER
from hubodo.emulator.board.hypercall import Handler, Op, Reply
from hubodo.emulator.chips.faults import BrownOut, Reset, ScriptedFault, Stall, Unplug
from hubodo.units import NS_PER_S


class Schedule:
    """Of one board, from power-on on; times in ns.

    Attributes:
        end: when it is switched off. plug_at: when its cable is put back. watchdog_at: when its watchdog
            restarts it, unless it is fed before.
    """

    def __init__(self, faults: Sequence[ScriptedFault], run_for: float | None) -> None:
        self.end = FOREVER if run_for is None else run_for * NS_PER_S
        self.plug_at = FOREVER
        self.watchdog_at = FOREVER
        self._watchdog_timeout = 0.0
        self._script = sorted(
            (f for f in faults if isinstance(f, Reset | Unplug) or _restarts(f)), key=lambda f: f.t
        )
        self._stalls = sorted((f for f in faults if isinstance(f, Stall)), key=lambda f: f.t)

    @property
    def next(self) -> float:
        """When the next of all this is due."""
        scripted = self._script[0].t * NS_PER_S if self._script else FOREVER
        return min(self.watchdog_at, self.plug_at, self.end, scripted)

    @property
    def quiet(self) -> float:
        """When the next of all this is due, stalls with it."""
        return min(self.next, self._stalls[0].t * NS_PER_S if self._stalls else FOREVER)

    def due(self, t: float) -> ScriptedFault | None:
        """The next scripted fault that is due at t: a reset, a brown-out or a cable that is pulled."""
        if self._script and self._script[0].t * NS_PER_S <= t:
            return self._script.pop(0)
        return None

    def stall(self, t: float) -> tuple[int, float]:
        """How many stalls begin in a call that is over at t, and when it is over with them."""
        count = 0
        while self._stalls and self._stalls[0].t * NS_PER_S <= t:
            t += self._stalls.pop(0).seconds * NS_PER_S
            count += 1
        return count, t

    def handlers(self) -> dict[int, Handler]:
        """What each call does here."""
        return {Op.WDT: self._watchdog}

    def _watchdog(self, a: int, payload: bytes, t: float) -> Reply:
        """Feeds the watchdog, or starts it with a timeout."""
        if a:
            self._watchdog_timeout = struct.unpack("<I", payload)[0] * 1e6
        if self._watchdog_timeout:
            self.watchdog_at = t + self._watchdog_timeout
        return Reply(t)

    def stop_watchdog(self) -> None:
        """The processor restarts: its watchdog is off."""
        self.watchdog_at, self._watchdog_timeout = FOREVER, 0.0


def _restarts(fault: ScriptedFault) -> bool:
    return isinstance(fault, BrownOut) and fault.of == "board"
