"""A slip that is found late: the filter goes back to where it began and takes the windows since then anew."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import HEADING, SPEED, X, Y
from hubodo.fuse.wheel.grip import BANK, LONGEST, Slip
from hubodo.fuse.wheel.measurements import WindowNoise, rolling
from hubodo.fuse.wheel.state import Wheel, renew
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.update import Pairs, Updated
from hubodo.fuse.wheel.window import WINDOW, Window

if TYPE_CHECKING:
    from hubodo.fuse.wheel.step import WheelStep


class Past(NamedTuple):
    """A window with the stillness of each wheel; x, p: states and covariance before it."""

    number: int
    pairs: Pairs
    stills: list[Stillness]
    x: list[float]
    p: Array


@dataclass
class _Beyond:
    """What a wheel that is lost rolled beyond the vehicle since it agrees with its accelerometer: it is calm.

    x, y: m. windows: so many. slip: m/s, when that began.
    """

    x: float = 0.0
    y: float = 0.0
    windows: int = 0
    slip: float = 0.0

    def go(self, slip: float, heading: float, calm: int) -> None:
        """One window; slip: m/s, heading: rad, calm: windows in which it agreed, by now."""
        if calm <= 1:
            self.x, self.y, self.slip = 0.0, 0.0, slip
        self.windows = calm
        if calm:
            self.x += slip * math.cos(heading) * WINDOW
            self.y += slip * math.sin(heading) * WINDOW


class Hindsight:
    """The last windows, as many as a slip may be old when it is found."""

    def __init__(self, noise: WindowNoise) -> None:
        self._noise = noise
        self._beyond = [_Beyond(), _Beyond()]
        self._past: deque[Past] = deque(maxlen=BANK[-1])
        self._headings: deque[float] = deque(maxlen=LONGEST + BANK[-1])

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
        now, began, moved = self._past[-1], {}, False
        self._headings.append(core.x[core.columns.vehicle[HEADING]])
        for index, (wheel, window) in enumerate(now.pairs):
            push = found.pushes[index]
            if wheel.grip.lost:
                slip, variance = self._slip(core, wheel, window)
                carried = core.x[core.columns.vehicle[SPEED]] if core.carrying else None
                back = wheel.grip.follow(now.number, push, slip, variance, carried, core.fastest)
                self._beyond[index].go(slip, self._headings[-1], wheel.grip.calm)
                if back and carried is not None and not wheel.grip.jumped:
                    self._rolled_on(core, (slip, variance), wheel.grip.slips[-1], self._beyond[index])
                    moved = True
                elif back:
                    self._doubt(core, slip, variance, wheel.grip.slips[-1])
                continue
            if found.stillness is not Stillness.MOVING:
                wheel.grip.rest()
                continue
            if window.spin_clipped > 0.0:
                # Where it was a moment ago gravity alone has told.
                wheel.grip.settle_anew()
                continue
            first = wheel.grip.add(now.number, push, found.rates[index])
            if first is not None:
                began[index] = max(first, self._past[0].number)
        if moved:
            # What was kept of the last windows is of another speed and place.
            self.forget()
            return found
        if not began:
            return found
        for index, first in began.items():
            core.wheels[index].grip.begin(first)
        return self._go_back(core, began)

    def _slip(self, core: WheelStep, wheel: Wheel, window: Window) -> tuple[float, float]:
        """m/s by which a wheel turns faster than the vehicle moves, and the variance of that, (m/s)²."""
        wheel.view.look(core.x, window, resting=False)
        row = rolling.measure(wheel.view, self._noise)
        h = core.derivatives(row, wheel.at)
        return row[0] / WINDOW, (float(h @ core.p @ h) + row[1]) / WINDOW**2

    def _go_back(self, core: WheelStep, began: Mapping[int, int]) -> Updated:
        """Takes the last windows in anew, now that wheels are known to have spun since those in `began`.

        The poses that were made meanwhile stay as they are.
        """
        again = [past for past in self._past if past.number >= min(began.values())]
        self._past.clear()
        core.x, core.p = list(again[0].x), again[0].p.copy()
        before = core.slipped.get(again[0].number - 1)
        core.carrying = before is not None and all(before)
        core.prediction.forget()
        none = (False,) * len(core.wheels)
        for place, past in enumerate(again):
            if place:
                core.advance(again[place - 1].pairs)
            lost = tuple(
                away or (index in began and past.number >= began[index])
                for index, away in enumerate(core.slipped.get(past.number, none))
            )
            self._past.append(past._replace(x=list(core.x), p=core.p.copy()))
            found = core.work_in(past.number, past.pairs, past.stills, lost)
        for wheel in core.wheels:
            wheel.grip.forget()
        return found

    def _doubt(self, core: WheelStep, slip: float, variance: float, spell: Slip) -> None:
        """A wheel is back with another speed than was carried: that may have been wrong all the while.

        And before that, for as long as a slip may be old when it is found: one that touches the road again
        shows what it lost as it ran out in the air.
        """
        wrong = slip * slip - variance
        if wrong <= 0.0:
            return
        lasted = round((spell.end - spell.begin) / WINDOW) + BANK[-1]
        _doubt_way(core, wrong, _ahead(list(self._headings)[-lasted:]))
        speed = core.columns.vehicle[SPEED]
        core.p[speed, speed] += wrong

    def _rolled_on(self, core: WheelStep, slip: tuple[float, float], spell: Slip, beyond: _Beyond) -> None:
        """A wheel that is believed without having jumped back has rolled on the road since it became calm.

        The speed that was carried was wrong: since the slip began, or before that, where a wheel had run out
        in the air, too slowly to be seen, and what was found is where it touched the road. Since it is calm
        the wheel shows the way. Before, speed is taken to have been lost evenly. slip: m/s, with variance.
        """
        at = core.columns.vehicle
        place, speed = [at[X], at[Y]], at[SPEED]
        inside = max(0, round((spell.end - spell.begin) / WINDOW) - beyond.windows)
        until = len(self._headings) - beyond.windows
        ahead = _ahead(list(self._headings)[max(0, until - inside - BANK[-1]) : until])
        lost = 0.5 * beyond.slip
        x, y = (lost * WINDOW * ahead[:, ahead.shape[1] - inside :].sum(axis=1)).tolist()
        core.x[at[X]] += beyond.x + x
        core.x[at[Y]] += beyond.y + y
        core.x[speed] += slip[0]
        # The place as it is where the speed is known; what else is believed does not become surer by that.
        by = core.p[speed].copy()
        core.p -= np.outer(by, by / by[speed])
        by[place] = 0.0
        core.p[np.diag_indices_from(core.p)] += by * by / by[speed]
        renew(core.p, speed, slip[1])
        _doubt_way(core, lost * lost, ahead)
        self._beyond = [_Beyond(), _Beyond()]


def _ahead(headings: list[float]) -> Array:
    """(2, n) unit vectors of headings in rad, (n,)."""
    return np.array([np.cos(headings), np.sin(headings)])


def _doubt_way(core: WheelStep, wrong: float, ahead: Array) -> None:
    """A speed that may have been wrong, (m/s)², all the windows in which the vehicle headed so, (2, n).

    A speed that is off by s or less in a time T, whenever, is off by a way e with e e' <= s² T int u u' dt,
    u where it headed (Cauchy-Schwarz).
    """
    place = [core.columns.vehicle[X], core.columns.vehicle[Y]]
    core.p[np.ix_(place, place)] += wrong * WINDOW**2 * ahead.shape[1] * (ahead @ ahead.T)
