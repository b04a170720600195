"""Log of the outages of a drive, in which no wheel was received, and of standstill across them."""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.records import WheelWindows
from hubodo.fuse.wheel.window import WINDOW_S, WINDOWS_PER_SECOND

_CONFIRMATION_WINDOWS = WINDOWS_PER_SECOND + WINDOWS_PER_SECOND
"""Windows after an outage in which standstill may be confirmed: one second for detection, one for a late
second wheel.
"""

_MAX_GRAVITY_TURN = 0.1
"""rad of change in the direction of gravity in a wheel that did not roll: 15 mm on a radius of 0.15 m, by
which a tyre creeps and a vehicle settles. Estimated.
"""

_STATIONARY_HEADING_SIGMA = 0.01
"""rad, 1 sigma, rotation of a vehicle whose wheels did not roll. Estimated."""

_MAX_LISTED_OUTAGES = 100
"""Outages that are listed one by one."""


@dataclass(frozen=True, slots=True)
class WheelOutage:
    """An outage of all wheels: start and end, s, and whether the vehicle was stationary.

    A vehicle is assumed stationary if it stood still before and after and its wheel angles are unchanged.
    """

    start: float
    end: float
    was_stationary: bool = False


@dataclass
class OutageLog:
    """The outages of a drive, oldest first; only the first `_MAX_LISTED_OUTAGES` are listed."""

    listed_outages: list[WheelOutage] = field(default_factory=list)
    count: int = 0
    seconds: float = 0.0
    may_have_been_stationary: bool = False
    _forces: list[complex] = field(default_factory=list)
    _heading_variance: float = 0.0
    _windows: int = 0

    def add_outage(
        self,
        start: float,
        end: float,
        heading_variance: float,
        forces: Sequence[complex] | None,
    ) -> None:
        """Add an outage from start to end, s.

        heading_variance: rad², added to the heading. forces: m/s², mean specific force in each wheel of a
        vehicle that stood still before, else None.
        """
        self.count += 1
        self.seconds += end - start
        if len(self.listed_outages) < _MAX_LISTED_OUTAGES:
            self.listed_outages.append(WheelOutage(start, end))
        self._heading_variance = heading_variance
        self.may_have_been_stationary, self._windows = forces is not None, 0
        self._forces = list(forces or ())

    def check_standstill(self, windows: WheelWindows, motion_state: MotionState) -> float:
        """Process a window after an outage before which the vehicle stood still.

        If the vehicle stands still and gravity has the same direction in its wheels, it was not turned.
        Return the change of the heading variance, rad²: that of the outage, uncorrelated with all states,
        is removed.
        """
        change = 0.0
        self._windows += 1
        if motion_state is MotionState.STANDSTILL:
            self.may_have_been_stationary = False
            forces = zip(self._forces, (wheel.standstill.force for wheel, _ in windows), strict=True)
            received = [(before, after) for before, after in forces if before != 0j and after != 0j]
            if received and all(
                abs(cmath.phase(after * before.conjugate())) < _MAX_GRAVITY_TURN for before, after in received
            ):
                change = _STATIONARY_HEADING_SIGMA**2 - self._heading_variance
                if self.count == len(self.listed_outages):
                    self.listed_outages[-1] = replace(self.listed_outages[-1], was_stationary=True)
        elif self._windows >= _CONFIRMATION_WINDOWS:
            self.may_have_been_stationary = False
        return change

    def list_warnings(self, names: str) -> list[str]:
        """Return one line for each listed outage; names: names of the nodes as text."""
        lines = []
        for outage in self.listed_outages:
            duration = outage.end - outage.start
            text = (
                f"{names}: not heard from t = {outage.start:.1f} to {outage.end:.1f} s ({duration:.1f} s): "
            )
            if outage.was_stationary:
                text += "it stood before and after as if never moved, so its heading is kept; "
            else:
                text += "where it went is not known; "
            lines.append(text + "position as far as a vehicle can go, sigmas grow there")
        if self.count > len(self.listed_outages):
            lines.append(f"{names}: not heard {self.count - len(self.listed_outages)} more times")
        return lines

    @property
    def windows(self) -> int:
        """Return the total number of windows in outages."""
        return round(self.seconds / WINDOW_S)
