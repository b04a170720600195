"""The times in which no wheel was heard: when, what was believed of them, and whether the vehicle stood."""

from __future__ import annotations

import cmath
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import HEADING, Entry
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.update import Pairs
from hubodo.fuse.wheel.window import WINDOW

_SOON = 20
"""Windows after a silence within which a vehicle that stands shows it: a second that is looked at, and a
second in which the other wheel may come late."""

_SAME = 0.1
"""rad by which gravity may lie elsewhere in a wheel that was not moved: 15 mm of a wheel of 0.15 m, by which
a tyre creeps and a vehicle settles. Estimated."""

_NUDGED = 0.01
"""rad, 1 sigma, by which a vehicle whose wheels stand as before may have been turned. Estimated."""

_KEPT = 100
"""Silences that are told one by one."""


@dataclass(frozen=True, slots=True)
class Silence:
    """begin, end: s. stood: the vehicle rested before and after, its wheels as they had stood."""

    begin: float
    end: float
    stood: bool = False


@dataclass
class Silences:
    """The silences of a drive, oldest first, the first ones of many."""

    told: list[Silence] = field(default_factory=list)
    count: int = 0
    seconds: float = 0.0
    open: bool = False
    _forces: list[complex] = field(default_factory=list)
    _turned: float = 0.0
    _windows: int = 0

    def begin(
        self,
        begin: float,
        end: float,
        turned: float,
        forces: Sequence[complex] | None,
    ) -> None:
        """A silence from begin to end, s.

        turned: rad², variance of the heading that came with it. forces: m/s² in each wheel of a vehicle that
        stood before, else None.
        """
        self.count += 1
        self.seconds += end - begin
        if len(self.told) < _KEPT:
            self.told.append(Silence(begin, end))
        self._turned = turned
        self.open, self._windows = forces is not None, 0
        self._forces = list(forces or ())

    def look(self, p: Array, at: Mapping[Entry, int], pairs: Pairs, stillness: Stillness) -> None:
        """A window after a silence before which the vehicle stood; p: covariance, in place.

        Where it stands now, and gravity lies in its wheels as before, it was not turned: the variance that
        the silence gave its heading had nothing to do with any other state, and is taken away again.
        """
        self._windows += 1
        if stillness is Stillness.RESTING:
            self.open = False
            forces = zip(self._forces, (wheel.rest.force for wheel, _ in pairs), strict=True)
            both = [(was, now) for was, now in forces if was != 0j and now != 0j]
            if both and all(abs(cmath.phase(now * was.conjugate())) < _SAME for was, now in both):
                place = at[HEADING]
                p[place, place] += _NUDGED**2 - self._turned
                if self.count == len(self.told):
                    self.told[-1] = replace(self.told[-1], stood=True)
        elif self._windows >= _SOON:
            self.open = False

    def lines(self, names: str) -> list[str]:
        """What a user must know of them; names: of the nodes."""
        found = []
        for silence in self.told:
            gone = silence.end - silence.begin
            text = f"{names}: not heard from t = {silence.begin:.1f} to {silence.end:.1f} s ({gone:.1f} s): "
            if silence.stood:
                text += "it stood before and after as if never moved, so its heading is kept; "
            else:
                text += "where it went is not known; "
            found.append(text + "position as far as a vehicle can go, sigmas grow there")
        if self.count > len(self.told):
            found.append(f"{names}: not heard {self.count - len(self.told)} more times")
        return found

    @property
    def windows(self) -> int:
        """Of all silences."""
        return round(self.seconds / WINDOW)
