"""Scripted actions on other devices at virtual times."""

from __future__ import annotations

from collections.abc import Callable

from hubodo.ingest.live.virtual_computer import SentBytes, VirtualComputer
from hubodo.units import NS_PER_S


class Script:
    """Actions at times (s from now on), each after all bytes sent before were read.

    It must be plugged in before the devices that it acts on.
    """

    path = ""

    def __init__(self, computer: VirtualComputer, *steps: tuple[float, Callable[[], None]]) -> None:
        self._steps = [(computer.now_ns() + round(t * NS_PER_S), act) for t, act in steps]
        computer.plug_in(self)

    def advance_to(self, t_ns: int, sent_count: int | None) -> None:
        while self._steps and self._steps[0][0] <= t_ns:
            self._steps.pop(0)[1]()

    def wait_for_writes(self) -> SentBytes:
        return []
