"""A slip that is found late: the filter goes back to where it began and takes the windows since then anew."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel.entries import HEADING, SPEED, X, Y
from hubodo.fuse.wheel.measurement_update import UpdateResult, WheelWindows
from hubodo.fuse.wheel.measurements import WindowNoise, rolling
from hubodo.fuse.wheel.motion_state import MotionState
from hubodo.fuse.wheel.slip_detector import MAX_SLIP_WINDOWS, SUM_LENGTHS_WINDOWS, ForwardResidual
from hubodo.fuse.wheel.state import Wheel
from hubodo.fuse.wheel.window import WINDOW_S, Window

if TYPE_CHECKING:
    from hubodo.fuse.wheel.filter_core import FilterCore

_CERTAIN = 3.0
"""Sigmas by which a speed must have been wrong to show that its wheel was lost before that was found."""


class FilterSnapshot(NamedTuple):
    """A window with the stillness of each wheel; x, p: states and covariance before it."""

    number: int
    pairs: WheelWindows
    motion_states: list[MotionState]
    x: list[float]
    p: Array


class _Lost(NamedTuple):
    """Of a wheel that is lost. since: the first window in which it may have been.

    calm: m/s by which it turned too fast as it began to agree with its accelerometer, if it does, and the
    variance of that.
    """

    since: int
    calm: tuple[float, float] = (0.0, 0.0)


class RollbackBuffer:
    """The last windows: a slip as long as one may last, that began as long before as one may be unseen."""

    def __init__(self, noise: WindowNoise) -> None:
        self._noise = noise
        self._past: deque[FilterSnapshot] = deque(maxlen=MAX_SLIP_WINDOWS + SUM_LENGTHS_WINDOWS[-1])
        self._headings: deque[float] = deque(maxlen=MAX_SLIP_WINDOWS + SUM_LENGTHS_WINDOWS[-1])
        self._lost = [_Lost(0), _Lost(0)]
        self._moving = 0

    def keep(self, past: FilterSnapshot) -> None:
        """The window that is worked in next."""
        self._past.append(past)

    def forget(self) -> None:
        """Nothing is gone back to beyond here: something came in that would be lost."""
        self._past.clear()

    def judge(self, core: FilterCore, found: UpdateResult) -> UpdateResult:
        """Looks for slips that begin or end with the newest window, which `core` has worked in."""
        if not self._past:
            return found
        self._headings.append(core.x[core.columns.vehicle[HEADING]])
        if found.motion_state is not MotionState.MOVING:
            self._moving = self._past[-1].number + 1
        begins = [
            self._follow(core, index, wheel, window, found.forward_residuals[index])
            if wheel.slip_detector.is_slipping
            else self._look(core, index, wheel, window, found)
            for index, (wheel, window) in enumerate(self._past[-1].pairs)
        ]
        back_to = [begin for begin in begins if begin is not None]
        return self._go_back(core, min(back_to)) if back_to else found

    def _look(
        self, core: FilterCore, index: int, wheel: Wheel, window: Window, found: UpdateResult
    ) -> int | None:
        """The window with which a slip began, of a wheel that is taken to roll, if one shows."""
        if found.motion_state is not MotionState.MOVING:
            wheel.slip_detector.record_standstill()
            return None
        if window.spin_clipped > 0.0:
            # Where it was a moment ago gravity alone has told.
            wheel.slip_detector.require_agreement()
            return None
        now = self._past[-1].number
        first = wheel.slip_detector.detect_onset(
            now, found.forward_residuals[index], found.rolling_rates[index]
        )
        if first is None:
            return None
        oldest = max(self._past[0].number, self._moving)
        first = max(first, self._past[0].number)
        self._lost[index] = _Lost(min(first, max(oldest, first - SUM_LENGTHS_WINDOWS[-1])))
        wheel.slip_detector.start_slip(first)
        core.slip_schedule.mark(index, range(first, now + 1))
        return first

    def _follow(
        self, core: FilterCore, index: int, wheel: Wheel, window: Window, push: ForwardResidual | None
    ) -> int | None:
        """The window from which on the speed is doubted, of a wheel that is lost, if it shows in this one.

        A wheel that is back with another speed than was carried tells that it had been wrong all the while,
        and if surely, since before the slip was found: one that touches the road again shows what it lost as
        it ran out in the air. One that is believed again without having jumped back has rolled on the road
        ever since it became calm.
        """
        grip, now = wheel.slip_detector, self._past[-1].number
        slip, variance = self._slip(core, wheel, window)
        carried = core.x[core.columns.vehicle[SPEED]] if core.inertial_speed else None
        back = grip.detect_end(now, push, slip, variance, carried, core.max_speed)
        if grip.consistent_windows <= 1:
            self._lost[index] = self._lost[index]._replace(calm=(slip, variance))
        if not back:
            return None
        spell, lost = grip.slips[-1], self._lost[index]
        if carried is not None and grip.consistent_windows:
            spell.last, (slip, variance) = max(spell.first, now - grip.consistent_windows), lost.calm
            if not grip.ended_by_jump:
                # How well the speed was carried is of no account: the wheel rolls, whatever was carried.
                variance = 0.0
        assert spell.last is not None
        end = spell.last + 1
        core.slip_schedule.mark(index, range(end, now + 1), slipping=False)
        wrong = slip * slip - variance
        if wrong <= 0.0:
            return None
        first = lost.since if slip * slip > _CERTAIN**2 * variance else spell.first
        core.slip_schedule.mark(index, range(first, end))
        core.slip_schedule.inflate_speed(range(first, end), wrong)
        if first >= self._past[0].number:
            return first
        self._doubt(core, wrong, now + 1 - first)
        return None

    def _slip(self, core: FilterCore, wheel: Wheel, window: Window) -> tuple[float, float]:
        """m/s by which a wheel turns faster than the vehicle moves, and the variance of that, (m/s)²."""
        wheel.view.linearise(core.x, window, resting=False)
        row = rolling.measure(wheel.view, self._noise)
        h = core.derivatives(row, wheel.columns)
        return row[0] / WINDOW_S, (float(h @ core.p @ h) + row[1]) / WINDOW_S**2

    def _go_back(self, core: FilterCore, first: int) -> UpdateResult:
        """Takes the windows since then anew, with what is known now of wheels that were lost.

        The poses that were made meanwhile stay as they are.
        """
        again: list[FilterSnapshot] = []
        while self._past and self._past[-1].number >= first:
            again.append(self._past.pop())
        again.reverse()
        core.x, core.p = list(again[0].x), again[0].p.copy()
        core.inertial_speed = core.slip_schedule.all_slipping_before(again[0].number)
        core.prediction.clear_force()
        for place, past in enumerate(again):
            if place:
                core.advance(again[place - 1].pairs)
            self._past.append(past._replace(x=list(core.x), p=core.p.copy()))
            found = core.process_window(past.number, past.pairs, past.motion_states)
        for wheel in core.wheels:
            wheel.slip_detector.clear_sums()
        return found

    def _doubt(self, core: FilterCore, wrong: float, windows: int) -> None:
        """A speed that may have been wrong, (m/s)², in so many windows that cannot be gone back to.

        One that is off by s or less in a time T, whenever, is off by a way e with e e' <= s² T int u u' dt,
        u where it headed (Cauchy-Schwarz).
        """
        at = core.columns.vehicle
        headings = list(self._headings)[-windows:]
        ahead = np.array([np.cos(headings), np.sin(headings)])
        core.p[np.ix_([at[X], at[Y]], [at[X], at[Y]])] += wrong * WINDOW_S**2 * windows * (ahead @ ahead.T)
        core.p[at[SPEED], at[SPEED]] += wrong
