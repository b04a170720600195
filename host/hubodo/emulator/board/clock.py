"""True time of a board: the clock of the host, or virtual time that the firmware advances."""

from __future__ import annotations

import time

from hubodo.emulator.board.settings import Clock

FOREVER = float("inf")
_WAIT_STEP_NS = 20_000_000


class BoardClock:
    """True time of a board, ns since power-on."""

    def __init__(self, settings: Clock) -> None:
        self.settings = settings
        self.stepped = settings.kind != "real"
        self.paced = settings.kind == "paced"
        self.lockstep = settings.kind == "lockstep"
        self.limit = 0.0 if self.lockstep else FOREVER
        """Time limit of a lockstep clock, ns."""
        self.t = 0.0
        """Current virtual time, ns."""
        self.zero_ns = 0
        """time.monotonic_ns() at power-on."""

    def switch_on(self) -> None:
        """Start at zero, now or at the time in the settings."""
        power_on_ns = self.settings.power_on_ns
        self.zero_ns = time.monotonic_ns() if power_on_ns is None else power_on_ns

    def now(self) -> float:
        """Return the time, ns since power-on."""
        return self.t if self.stepped else time.monotonic_ns() - self.zero_ns

    def wait_until(self, deadline: float) -> None:
        """Advance virtual time during a wait, at most to `deadline`.

        A host on a terminal gets real time to answer.
        """
        if self.paced:
            reachable = (time.monotonic_ns() - self.zero_ns) / self.settings.pace
        elif self.lockstep:
            reachable = self.limit
        else:
            reachable = self.t + _WAIT_STEP_NS
        self.t = max(self.t, min(deadline, reachable))
