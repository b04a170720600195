"""One step of the wheel filter, an error-state Kalman filter: a window of each wheel in, a pose out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from operator import itemgetter

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel import two_wheels
from hubodo.fuse.wheel.about_axle import about_the_axle
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import EXCESS, HEADING, SPEED, TRACK_WIDTH, WHEEL_ANGLE, X, Y
from hubodo.fuse.wheel.excess import carried, keep_upright
from hubodo.fuse.wheel.hindsight import Hindsight, Past
from hubodo.fuse.wheel.lost_wheels import LostWheels
from hubodo.fuse.wheel.measurements import WindowNoise, centripetal, steady, surface_speed
from hubodo.fuse.wheel.prediction import Prediction, each_still, least_still
from hubodo.fuse.wheel.propagation import WheelMotion
from hubodo.fuse.wheel.records import POSE, Innovation, Kept, Pose, Step
from hubodo.fuse.wheel.shortening import Shortening
from hubodo.fuse.wheel.silence import SilenceMotion, agility
from hubodo.fuse.wheel.silences import Silences
from hubodo.fuse.wheel.state import Wheel, initial_state
from hubodo.fuse.wheel.state_vector import StateVector
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.update import Pairs, Updated, WheelUpdate
from hubodo.fuse.wheel.window import NOTHING, WINDOW, Window

_SYMMETRIC = 16
"""Steps after which rounding is taken out of the covariance's symmetry; in so many it is some 1e-15."""

_STARTS = 3.0
"""m/s; a first window that is faster, three sigma of what SPEED begins with, is no start from rest."""

_JUST_NOW = 5
"""Windows within which one wheel may be heard no more before the other, and the vehicle still rests.

Estimated.
"""


class WheelStep(StateVector):
    """State vector, covariance and the step that carries both through a window.

    x: list of the states, in the order of `columns`. p: their covariance. Copies (copy.deepcopy) go their own
    ways.
    """

    def __init__(self, config: WheelConfig, told: LostWheels | None = None) -> None:
        """told: which wheels spin by themselves; None: that is to be found."""
        begin = initial_state(config)
        super().__init__(begin)
        self.config = config
        self.agreement = two_wheels.Agreement(config.track_width)
        self.steps = self.windows = 0
        self.keep = False
        self.kept = Kept([], np.empty(0), [], [], np.empty(0))
        self.slips = told or LostWheels(len(self.wheels))
        self.silences = Silences()
        self._shortening = Shortening()
        self.prediction = Prediction(begin.columns, WindowNoise(config.noise, config.radius))
        self.carrying = False
        self._update = WheelUpdate(config, begin.columns, pushed=told is None)
        self._motion = WheelMotion(config, begin)
        self._over_silence = SilenceMotion(config, begin)
        self._timeless = False
        self.fastest = 0.0
        """m/s that the vehicle has gone, by what was measured."""
        self._rested = -_JUST_NOW
        self.pose = [self._at[entry] for entry in POSE]
        self._of_pose = itemgetter(*self.pose)
        self._covariance = np.array(
            [[row * len(self.x) + column for column in self.pose] for row in self.pose]
        )
        self._searching = told is None
        self._hindsight = Hindsight(WindowNoise(config.noise, config.radius))
        self._tape = len(self.wheels) == 2 and TRACK_WIDTH not in config.known and not config.told

    def begin(self, windows: Sequence[Sequence[Window]]) -> None:
        """Look at the first windows as a whole for the wheel angles; `step` follows with each of them."""
        for index, wheel in enumerate(self.wheels):
            wheel.rest.begin([row[index] for row in windows])
        for row in windows:
            for wheel, window in zip(self.wheels, row, strict=True):
                wheel.listen(window)
        for index, wheel in enumerate(self.wheels):
            pauses = any(a[index] is not NOTHING and b[index] is NOTHING for a, b in pairwise(windows))
            if wheel.heard > 0 and wheel.level != 0j and not pauses:
                wheel.join(self.x, self.p, at_begin=True)
                self._look_at_steady(wheel)
        self._begin_rolling(windows)

    def _begin_rolling(self, windows: Sequence[Sequence[Window]]) -> None:
        """Speed where the drive begins faster than anybody starts from rest."""
        rates = [
            wheel.geometry.radius * (row[index].spin / WINDOW + self.x[wheel.at[EXCESS]])
            for index, wheel in enumerate(self.wheels)
            for row in [next((row for row in windows if row[index].missing == 0.0), None)]
            if row is not None and wheel.joined
        ]
        if rates and min(map(abs, rates)) > _STARTS:
            self.x[self._at[SPEED]] = sum(rates) / len(rates)

    def step(self, step: Step, needed: int) -> Pose:
        """On to the end of a step. needed: windows in which the angle of a wheel is looked for."""
        self.windows += step.spans
        self._timeless = False
        end = (step.number + 1) * WINDOW
        if not step.windows:
            return self._pass_silence(end, step.number, step.spans)
        pairs: Pairs = tuple(zip(self.wheels, step.windows, strict=True))
        renewed = self._listen(pairs, needed) if step.listen else []
        told = step.speeds is not None
        if renewed or told:
            self._hindsight.forget()
        pairs = self._carried(pairs, renewed)
        stills = each_still(pairs, self.x, self.p)
        if self._searching:
            for index, wheel in enumerate(self.wheels):
                if wheel.grip.lost:
                    self.slips.mark(index, range(step.number, step.number + 1))
        if self.silences.open:
            self._hindsight.forget()
            lost = self.slips.of(step.number)
            self.silences.look(self.p, self._at, pairs, least_still(stills, lost))
        if self._searching:
            self._hindsight.keep(Past(step.number, pairs, stills, list(self.x), self.p.copy()))
        found = self.work_in(step.number, pairs, stills, renewed, told)
        if self._searching:
            found = self._hindsight.judge(self, found)
        if step.speeds is not None:
            self._roll(step.speeds)
        if found.stillness is Stillness.RESTING:
            self._rested = self.windows
        self._watch(pairs, found)
        self.steps += 1
        self.advance(pairs)
        if self.steps % _SYMMETRIC == 0:
            self.p[:] = 0.5 * (self.p + self.p.T)
        self._go()
        if self.keep:
            self.kept = self.kept._replace(shortened=self._shortening.covariance)
        return self._pose(end, found.stillness, found.nis, found.degrees)

    def advance(self, pairs: Pairs) -> None:
        """To the end of a window that has been worked in."""
        self._motion.advance(self.x, self.p, pairs)

    def transition(self) -> Array:
        """Derivatives of the states at the end of the last step by those after its measurements, (n, n)."""
        return np.eye(len(self.x)) if self._timeless else self._motion.transition()

    def fix(self, new: Innovation) -> None:
        """Works a position in."""
        # Going back would lose it.
        self._hindsight.forget()
        weight = np.linalg.solve(new.s, new.ph.T)
        self.correct(new.z @ weight, new.ph @ weight)

    def _go(self) -> None:
        """The way of a step is as much shorter as its heading is not known; what is told needs no way."""
        if not self.config.told:
            heading = self._at[HEADING]
            self._shortening.go(self.x[self._at[X]], self.x[self._at[Y]], self.p.item(heading, heading))

    def _pose(self, end: float, stillness: Stillness, nis: float, degrees: int) -> Pose:
        covariance = self.p.take(self._covariance)
        x, y, heading, speed, yaw_rate = self._of_pose(self.x)
        if not self.carrying:
            self.fastest = max(self.fastest, abs(speed))
        covariance[:2, :2] += self._shortening.covariance
        return Pose(end, x, y, heading, speed, yaw_rate, covariance, stillness, nis, degrees, self.carrying)

    # -- silence --------------------------------------------------------------------------------------------

    def _pass_silence(self, end: float, number: int, windows: int) -> Pose:
        """Nothing was heard of any wheel: what vehicles do meanwhile."""
        stood = self.windows - windows - self._rested < _JUST_NOW
        seconds = windows * WINDOW
        passed, turned = self._over_silence.advance(self.x, self.p, seconds, agility(self.fastest), stood)
        forces = [wheel.rest.force for wheel in self.wheels]
        self.silences.begin(end - seconds, end, turned, forces if stood else None)
        self._hindsight.forget()
        self.prediction.forget()
        self.carrying = False
        self._go()
        for wheel in self.wheels:
            wheel.unhear(windows)
            wheel.rest.forget()
            wheel.grip.unhear(number)
        if self.keep:
            after = list(self.x), self.p.copy()
            self.kept = Kept(*after, [], *after, passed=passed, shortened=self._shortening.covariance)
        self._timeless = True
        return self._pose(end, Stillness.MOVING, 0.0, 0)

    # -- one window -----------------------------------------------------------------------------------------

    def _listen(self, pairs: Pairs, needed: int) -> list[int]:
        """The places of the states that were begun anew with wheel angles that were found."""
        found = []
        for wheel, window in pairs:
            if not wheel.joined and wheel.heard >= needed and wheel.level != 0j:
                found += wheel.join(self.x, self.p, at_begin=False)
            wheel.listen(window)
        return found

    def _carried(self, pairs: Pairs, renewed: list[int]) -> Pairs:
        """The windows with the spin that they are believed to have; adds to `renewed`."""
        made = []
        for wheel, window in pairs:
            turned, anew = carried(self.x, self.p, wheel, about_the_axle(self.x, wheel, window))
            made.append((wheel, turned))
            renewed += anew
            if anew or window.all_clipped:
                # The spin that a clipped gyro does not show is found once, and never gone back to.
                self._hindsight.forget()
        return tuple(made)

    def work_in(
        self,
        number: int,
        pairs: Pairs,
        stills: Sequence[Stillness],
        renewed: Sequence[int] = (),
        told: bool = False,
    ) -> Updated:
        """Takes the states to a window, and the window into the states.

        renewed: the states that were begun anew before. told: whether another odometer tells what the wheels
        do.
        """
        stillness, carries = Stillness.MOVING, False
        lost = self.slips.of(number)
        for wheel, away in zip(self.wheels, lost, strict=True):
            wheel.away = away
        if any(lost):
            carries = not any(wheel.rolls(window) for wheel, window in pairs)
        if number in self.slips.doubt:
            speed = self._at[SPEED]
            self.p[speed, speed] += self.slips.doubt[number]
        # The window in which a wheel is back tells how wrong the speed was that was carried until then.
        carry, self.carrying = carries or self.carrying, carries
        if not carry:
            stillness = least_still(stills, lost)
        self.prediction.predict(self.x, self.p, pairs, stillness, carry, told, self.fastest)
        prior = (list(self.x), self.p.copy()) if self.keep else None
        found = self._update.work_in(self.x, self.p, pairs, stillness)
        self.x, self.p = found.x, found.p
        anew = [*renewed, *self.prediction.renewed]
        for wheel, window in pairs:
            self._look_at_steady(wheel)
            if window.all_clipped and window.force_clipped == 0.0 and not wheel.follower.seen:
                self._feel_spin(wheel, window)
            if window.all_clipped and wheel.joined:
                anew += keep_upright(self.x, self.p, wheel, window)
        if self._tape:
            self._ask_tape()
        if prior is not None:
            made = self.prediction.carried
            by = None if made is None else (self._at[SPEED], made)
            self.kept = Kept(*prior, anew, list(self.x), self.p.copy(), by)
        return found

    # -- what else the windows say --------------------------------------------------------------------------

    def _ask_tape(self) -> None:
        """Tells the track once what the vehicle file says, if the drive makes it likely."""
        place = self._at[TRACK_WIDTH]
        error, variance = self.x[place], self.p.item(place, place)
        noise = two_wheels.careful_tape(error, variance, TRACK_WIDTH.prior)
        if noise is None:
            return
        self._tape = False
        self._hindsight.forget()
        if math.isfinite(noise):
            ph = self.p[place].copy()
            s = variance + noise
            self.correct(ph * (-error / s), np.outer(ph, ph / s))

    def _look_at_steady(self, wheel: Wheel) -> None:
        """What the search of a clipped spin has shown besides; before the first window if it begins so."""
        seen, wheel.steady = wheel.steady, None
        if seen is not None:
            for row in range(steady.ROWS):
                self.work_in_row(steady.measure(self.x, wheel.at, seen)[row], wheel.at)

    def _feel_spin(self, wheel: Wheel, window: Window) -> None:
        wheel.view.look(self.x, window, resting=False)
        row = centripetal.measure(wheel.view, self.config.noise)
        if row is not None:
            self.work_in_row(row, wheel.at)

    def _roll(self, speeds: tuple[float, float]) -> None:
        """What another odometer says of the wheels' surfaces."""
        for side, speed in zip((1.0, -1.0), speeds, strict=True):
            contact = 0.5 * side * self.config.track_width
            self.work_in_row(surface_speed.measure(self.x, self._at, side, contact, speed), self._at)

    def _watch(self, pairs: Pairs, found: Updated) -> None:
        if found.slipping is not None:
            self.wheels[found.slipping].slips += 1
        for (wheel, window), rate in zip(pairs, found.rates, strict=True):
            wheel.watch(window, rate, self.x[wheel.at[WHEEL_ANGLE]])
        if (
            len(pairs) == 2
            and self.agreement.open
            and all(wheel.joined and window.missing == 0.0 and not wheel.away for wheel, window in pairs)
            and not any(window.spin_clipped + window.across_clipped for _, window in pairs)
        ):
            self._compare(found.rates, found.yaws)

    def _compare(self, rates: Sequence[float], yaws: Sequence[float]) -> None:
        """Two wheels with the yaw rates that their gyros feel: are they the axle that was declared?"""
        speeds = [rate * wheel.geometry.radius for rate, wheel in zip(rates, self.wheels, strict=True)]
        order = (0, 1) if self.wheels[0].geometry.side > 0 else (1, 0)
        left, right = (speeds[index] for index in order)
        blamed = self.agreement.add((yaws[order[0]], yaws[order[1]]), left, right)
        if blamed is None:
            return
        # Up to here the wrong wheel may have been believed.
        lost = 2.0 * max(abs(way) for way in self.agreement.travel)
        for place in (self._at[X], self._at[Y]):
            self.p[place, place] += lost * lost
        self._hindsight.forget()
        for wheel in self.wheels:
            wheel.trusted &= blamed != two_wheels.BOTH and blamed != wheel.geometry.side
            wheel.part = self.agreement.alone in (0.0, wheel.geometry.side)
            if self.agreement.steering:
                wheel.trusted = wheel.part
            if wheel.part and self.agreement.exchanged:
                wheel.trusted = True
                wheel.move_over()
