"""Warnings about the live odometry, each reported once."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from hubodo.fuse.wheel.drive_report import START_WINDOWS, list_warnings
from hubodo.fuse.wheel.filter import WheelFilter
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.units import NS_PER_S

MAX_WHEEL_WAIT_NS = 3 * NS_PER_S
"""Maximum time to wait for the second wheel after the first samples of the first."""
_MIN_ADVICE_DISTANCE_M = 10.0
_ADVICE_INTERVAL_WINDOWS = 50


class OdometerWarnings:
    """Collects what the warnings depend on, and remembers which ones were reported."""

    def __init__(self) -> None:
        self._initial_states = bytearray()  # not beyond the beginning: a drive may last for weeks
        self._was_stationary = False
        self._window_count = 0
        self._advised_window = 0
        self._reported_kinds: set[str] = set()
        self._slips_reported: dict[str, int] = {}

    def add_window(self, motion_state: int) -> None:
        """Add the motion state (`MotionState`) of the vehicle in the next window of the filter."""
        self._window_count += 1
        if len(self._initial_states) < START_WINDOWS:
            self._initial_states.append(int(motion_state))
        self._was_stationary |= motion_state == MotionState.STANDSTILL

    def new_warnings(
        self, wheels: WheelFilter, distance: float, late_nodes: Iterable[str], *, end: bool
    ) -> list[str]:
        """Return the warnings that were not reported yet.

        A slip is reported once it has ended; other warnings are evaluated every few seconds after the first
        10 m, and at the end. distance: driven so far, m. late_nodes: names of the nodes that came too late
        for the filter. end: the drive is over.
        """
        if not self._window_count:
            return []
        new = self._slip_warnings(wheels, end)
        is_due = (
            distance >= _MIN_ADVICE_DISTANCE_M
            and self._window_count >= self._advised_window + _ADVICE_INTERVAL_WINDOWS
        )
        if end or is_due:
            self._advised_window = self._window_count
            new += self._advice(wheels, late_nodes)
        return new

    def _slip_warnings(self, wheels: WheelFilter, end: bool) -> list[str]:
        new = []
        for wheel in wheels.core.wheels:
            for slip in wheel.slip_detector.slips[self._slips_reported.get(wheel.name, 0) :]:
                if end or slip.last is not None:
                    self._slips_reported[wheel.name] = self._slips_reported.get(wheel.name, 0) + 1
                    new.append(f"{wheel.name}: {slip.description}")
        return new

    def _advice(self, wheels: WheelFilter, late_nodes: Iterable[str]) -> list[str]:
        lines = [
            f"{name}: first samples more than {MAX_WHEEL_WAIT_NS // NS_PER_S} s after the other wheel; "
            "it is not used for the odometry"
            for name in sorted(late_nodes)
        ]
        states = [*self._initial_states, *([MotionState.STANDSTILL] if self._was_stationary else [])]
        new = []
        for line in [*lines, *list_warnings(wheels, np.array(states, np.float64))]:
            kind = re.sub(r"\d+(\.\d+)?", "#", line)
            if kind not in self._reported_kinds:
                self._reported_kinds.add(kind)
                new.append(line)
        return new
