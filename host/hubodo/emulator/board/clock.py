"""The board's true time: that of the machine, or stepped by what the firmware does."""

from __future__ import annotations

import time

from hubodo.emulator.board.settings import Clock

FOREVER = float("inf")
_WAIT_STEP_NS = 20_000_000


class BoardClock:
    """ns since the board was switched on."""

    def __init__(self, settings: Clock) -> None:
        self.settings = settings
        self.stepped = settings.kind != "real"
        self.paced = settings.kind == "paced"
        self.led = settings.kind == "led"
        self.limit = 0.0 if self.led else FOREVER
        """How far a led clock may go, ns."""
        self.t = 0.0
        """Of a stepped clock."""
        self.zero_ns = 0
        """time.monotonic_ns() at which the board was switched on."""

    def switch_on(self) -> None:
        """Time begins, at the moment the settings name or now."""
        wanted = self.settings.power_on_ns
        self.zero_ns = time.monotonic_ns() if wanted is None else wanted

    def now(self) -> float:
        """ns since the board was switched on."""
        return self.t if self.stepped else time.monotonic_ns() - self.zero_ns

    def wait_until(self, deadline: float) -> None:
        """Stepped: lets time pass in a wait; a host on a terminal gets a little real time to answer."""
        if self.paced:
            passed = (time.monotonic_ns() - self.zero_ns) / self.settings.pace
        elif self.led:
            passed = self.limit
        else:
            passed = self.t + _WAIT_STEP_NS
        self.t = max(self.t, min(deadline, passed))
