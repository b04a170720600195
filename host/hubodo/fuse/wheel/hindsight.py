"""A slip that is found late: the filter goes back to where it began and takes the windows since then anew."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import HEADING, SPEED, X, Y
from hubodo.fuse.wheel.grip import BANK, LONGEST, Push
from hubodo.fuse.wheel.measurements import WindowNoise, rolling
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.update import Pairs, Updated
from hubodo.fuse.wheel.window import WINDOW, Window

if TYPE_CHECKING:
    from hubodo.fuse.wheel.step import WheelStep

_CERTAIN = 3.0
"""Sigmas by which a speed must have been wrong to show that its wheel was lost before that was found."""


class Past(NamedTuple):
    """A window with the stillness of each wheel; x, p: states and covariance before it."""

    number: int
    pairs: Pairs
    stills: list[Stillness]
    x: list[float]
    p: Array


class _Lost(NamedTuple):
    """Of a wheel that is lost. since: the first window in which it may have been.

    calm: m/s by which it turned too fast as it began to agree with its accelerometer, if it does, and the
    variance of that.
    """

    since: int
    calm: tuple[float, float] = (0.0, 0.0)


class Hindsight:
    """The last windows: a slip as long as one may last, that began as long before as one may be unseen."""

    def __init__(self, noise: WindowNoise) -> None:
        self._noise = noise
        self._past: deque[Past] = deque(maxlen=LONGEST + BANK[-1])
        self._headings: deque[float] = deque(maxlen=LONGEST + BANK[-1])
        self._lost = [_Lost(0), _Lost(0)]
        self._moving = 0

    def keep(self, past: Past) -> None:
        """The window that is worked in next."""
        self._past.append(past)

    def forget(self) -> None:
        """Nothing is gone back to beyond here: something came in that would be lost."""
        self._past.clear()

    def judge(self, core: WheelStep, found: Updated) -> Updated:
        """Looks for slips that begin or end with the newest window, which `core` has worked in."""
        if not self._past:
            return found
        self._headings.append(core.x[core.columns.vehicle[HEADING]])
        if found.stillness is not Stillness.MOVING:
            self._moving = self._past[-1].number + 1
        begins = [
            self._follow(core, index, wheel, window, found.pushes[index])
            if wheel.grip.lost
            else self._look(core, index, wheel, window, found)
            for index, (wheel, window) in enumerate(self._past[-1].pairs)
        ]
        back_to = [begin for begin in begins if begin is not None]
        return self._go_back(core, min(back_to)) if back_to else found

    def _look(self, core: WheelStep, index: int, wheel: Wheel, window: Window, found: Updated) -> int | None:
        """The window with which a slip began, of a wheel that is taken to roll, if one shows."""
        if found.stillness is not Stillness.MOVING:
            wheel.grip.rest()
            return None
        if window.spin_clipped > 0.0:
            # Where it was a moment ago gravity alone has told.
            wheel.grip.settle_anew()
            return None
        now = self._past[-1].number
        first = wheel.grip.add(now, found.pushes[index], found.rates[index])
        if first is None:
            return None
        oldest = max(self._past[0].number, self._moving)
        first = max(first, self._past[0].number)
        self._lost[index] = _Lost(min(first, max(oldest, first - BANK[-1])))
        wheel.grip.begin(first)
        core.slips.mark(index, range(first, now + 1))
        return first

    def _follow(
        self, core: WheelStep, index: int, wheel: Wheel, window: Window, push: Push | None
    ) -> int | None:
        """The window from which on the speed is doubted, of a wheel that is lost, if it shows in this one.

        A wheel that is back with another speed than was carried tells that it had been wrong all the while,
        and if surely, since before the slip was found: one that touches the road again shows what it lost as
        it ran out in the air. One that is believed again without having jumped back has rolled on the road
        ever since it became calm.
        """
        grip, now = wheel.grip, self._past[-1].number
        slip, variance = self._slip(core, wheel, window)
        carried = core.x[core.columns.vehicle[SPEED]] if core.carrying else None
        back = grip.follow(now, push, slip, variance, carried, core.fastest)
        if grip.calm <= 1:
            self._lost[index] = self._lost[index]._replace(calm=(slip, variance))
        if not back:
            return None
        spell, lost = grip.slips[-1], self._lost[index]
        if carried is not None and grip.calm:
            spell.last, (slip, variance) = max(spell.first, now - grip.calm), lost.calm
            if not grip.jumped:
                # How well the speed was carried is of no account: the wheel rolls, whatever was carried.
                variance = 0.0
        assert spell.last is not None
        end = spell.last + 1
        core.slips.mark(index, range(end, now + 1), lost=False)
        wrong = slip * slip - variance
        if wrong <= 0.0:
            return None
        first = lost.since if slip * slip > _CERTAIN**2 * variance else spell.first
        core.slips.mark(index, range(first, end))
        core.slips.doubt_speed(range(first, end), wrong)
        if first >= self._past[0].number:
            return first
        self._doubt(core, wrong, now + 1 - first)
        return None

    def _slip(self, core: WheelStep, wheel: Wheel, window: Window) -> tuple[float, float]:
        """m/s by which a wheel turns faster than the vehicle moves, and the variance of that, (m/s)²."""
        wheel.view.look(core.x, window, resting=False)
        row = rolling.measure(wheel.view, self._noise)
        h = core.derivatives(row, wheel.at)
        return row[0] / WINDOW, (float(h @ core.p @ h) + row[1]) / WINDOW**2

    def _go_back(self, core: WheelStep, first: int) -> Updated:
        """Takes the windows since then anew, with what is known now of wheels that were lost.

        The poses that were made meanwhile stay as they are.
        """
        again: list[Past] = []
        while self._past and self._past[-1].number >= first:
            again.append(self._past.pop())
        again.reverse()
        core.x, core.p = list(again[0].x), again[0].p.copy()
        core.carrying = core.slips.all_before(again[0].number)
        core.prediction.forget()
        for place, past in enumerate(again):
            if place:
                core.advance(again[place - 1].pairs)
            self._past.append(past._replace(x=list(core.x), p=core.p.copy()))
            found = core.work_in(past.number, past.pairs, past.stills)
        for wheel in core.wheels:
            wheel.grip.forget()
        return found

    def _doubt(self, core: WheelStep, wrong: float, windows: int) -> None:
        """A speed that may have been wrong, (m/s)², in so many windows that cannot be gone back to.

        One that is off by s or less in a time T, whenever, is off by a way e with e e' <= s² T int u u' dt,
        u where it headed (Cauchy-Schwarz).
        """
        at = core.columns.vehicle
        headings = list(self._headings)[-windows:]
        ahead = np.array([np.cos(headings), np.sin(headings)])
        core.p[np.ix_([at[X], at[Y]], [at[X], at[Y]])] += wrong * WINDOW**2 * windows * (ahead @ ahead.T)
        core.p[at[SPEED], at[SPEED]] += wrong
