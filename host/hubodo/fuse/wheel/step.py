"""One step of the wheel filter, an error-state Kalman filter: a window of each wheel in, a pose out."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel import two_wheels
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import (
    EXCESS,
    HEADING,
    SLOPE,
    SPEED,
    WHEEL_ANGLE,
    YAW_RATE,
    Entry,
    X,
    Y,
)
from hubodo.fuse.wheel.excess import carried, keep_upright
from hubodo.fuse.wheel.measurements import Row, centripetal, position, surface_speed, zero_velocity
from hubodo.fuse.wheel.measurements.position import Position
from hubodo.fuse.wheel.prediction import forward_force, least_still
from hubodo.fuse.wheel.preintegration import NOTHING, WINDOW, Window
from hubodo.fuse.wheel.propagation import WheelMotion
from hubodo.fuse.wheel.silence import SilenceMotion, agility, swung, window_walk
from hubodo.fuse.wheel.silences import Silences
from hubodo.fuse.wheel.state import Wheel, initial_state
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.update import UNHEARD, Pairs, WheelUpdate

_SPEED_STEP, _YAW_STEP = 0.5, 0.5
"""m/s and rad/s by which speed and yaw rate may step from window to window.

So far that what is measured decides. Where neither is, both wander as silence.py has it. Estimated.
"""

_STARTS = 3.0
"""m/s; a first window that is faster, three sigma of what SPEED begins with, is no start from rest."""

_HARDEST = 5.0
"""m/s²; no wheel drives or brakes a vehicle harder.

Half of gravity, the grip of a good tyre on a dry road.
"""

_SYMMETRIC = 16
"""Steps after which rounding is taken out of the covariance's symmetry; in so many it is some 1e-15."""

_ENOUGH, _TURNING = 300, 1.0
"""How many windows, with a wheel faster than so many rad/s, tell whether gravity turns with it.

Half a minute. Estimated.
"""

_JUST_NOW = 5
"""Windows within which one wheel may be heard no more before the other, and the vehicle still rests.

Estimated.
"""

POSE = (X, Y, HEADING, SPEED, YAW_RATE)


class Step(NamedTuple):
    """What happened at once: the windows of all wheels of one number, in the order of the nodes.

    Or no windows: nothing was heard of any wheel in `spans` windows up to this number. listen: look for the
    angle of wheels that were not heard. speeds: m/s of the left and the right wheel's surface, where another
    odometer tells them.
    """

    windows: tuple[Window, ...]
    number: int
    listen: bool
    spans: int = 1
    speeds: tuple[float, float] | None = None


class Pose(NamedTuple):
    """End of a step.

    t: s; x, y: m; heading: rad, unwrapped; speed: m/s and yaw_rate: rad/s, means over the window. covariance:
    (5, 5) of x, y, heading, speed, yaw_rate. still: whether the vehicle stood still. nis, degrees: squared
    innovations of the step over their variance, and how many there were.
    """

    t: float
    x: float
    y: float
    heading: float
    speed: float
    yaw_rate: float
    covariance: Array
    still: Stillness
    nis: float
    degrees: int


class Kept(NamedTuple):
    """Both sides of a step's measurements: states and covariance before and after.

    renewed: the states that the step began anew, without memory. passed: (n, n), derivatives of the states
    before the measurements by those at the end of the step before, None where no time lies between. swung:
    (2, 2) m² of x and y beyond what p has.
    """

    prior_x: list[float]
    prior_p: Array
    renewed: list[int]
    x: list[float]
    p: Array
    swung: Array
    passed: Array | None = None


class Innovation(NamedTuple):
    """What a position says that is new.

    z: (2,) m, the position less what was expected; s: (2, 2) m², its covariance; ph: (n, 2), its covariance
    with the states; nis: z in units of s, squared.
    """

    z: Array
    s: Array
    ph: Array
    nis: float

    @property
    def cost(self) -> float:
        """Minus twice the logarithm of its likelihood, but for a constant."""
        return self.nis + float(np.linalg.slogdet(self.s)[1])


class WheelStep:
    """State vector, covariance and the step that carries both through a window.

    x: list of the states, in the order of `columns`. p: their covariance. Copies (copy.deepcopy) go their own
    ways.
    """

    def __init__(self, config: WheelConfig) -> None:
        begin = initial_state(config)
        self.config, self.x, self.p, self.wheels = config, begin.x, begin.p, begin.wheels
        self.columns, self._at = begin.columns, begin.columns.vehicle
        self.agreement = two_wheels.Agreement(config.track_width)
        self.steps = self.windows = 0
        self.keep = False
        self.kept = Kept([], np.empty(0), [], [], np.empty(0), np.zeros((2, 2)))
        self.silences = Silences()
        self._update = WheelUpdate(config, begin.columns)
        self._motion = WheelMotion(config, begin)
        self._over_silence = SilenceMotion(config, begin)
        self._timeless = False
        self._fastest, self._rested = 0.0, -_JUST_NOW
        self.pose = [self._at[entry] for entry in POSE]
        self._of_pose = itemgetter(*self.pose)
        self._covariance = np.array(
            [[row * len(self.x) + column for column in self.pose] for row in self.pose]
        )
        self._renewed: list[int] = []

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
        self._renewed, self._timeless = [], False
        end = (step.number + 1) * WINDOW
        if not step.windows:
            return self._pass_silence(end, step.spans)
        pairs = tuple(zip(self.wheels, step.windows, strict=True))
        if step.listen:
            for wheel, window in pairs:
                if not wheel.joined and wheel.heard >= needed and wheel.level != 0j:
                    self._renewed += wheel.join(self.x, self.p, at_begin=False)
                wheel.listen(window)
        pairs = tuple((wheel, self._carried(wheel, window)) for wheel, window in pairs)
        stillness = least_still(pairs, self.x, self.p)
        if stillness is Stillness.RESTING:
            self._rested = self.windows
        if stillness is Stillness.MOVING:
            self._predict_rates(pairs, step.speeds is not None)
        else:
            self._stand(stillness)
        prior = (list(self.x), self.p.copy()) if self.keep else None
        if self.silences.open:
            self.silences.look(self.p, self._at, pairs, stillness)
        found = self._update.work_in(self.x, self.p, pairs, stillness)
        self.x, self.p = found.x, found.p
        for wheel, window in pairs:
            if window.all_clipped and window.force_clipped == 0.0 and not wheel.follower.seen:
                self._feel_spin(wheel, window)
            if window.all_clipped and wheel.joined:
                self._renewed += keep_upright(self.x, self.p, wheel, window)
        if step.speeds is not None:
            self._roll(step.speeds)
        self._watch(pairs, found.rates, found.yaws)
        self.steps += 1
        kept = None if prior is None else (list(self.x), self.p.copy())
        self._motion.advance(self.x, self.p, pairs)
        if self.steps % _SYMMETRIC == 0:
            self.p[:] = 0.5 * (self.p + self.p.T)
        if prior is not None and kept is not None:
            self.kept = Kept(*prior, self._renewed, *kept, self._swung())
        return self._pose(end, stillness, found.nis, found.degrees)

    def transition(self) -> Array:
        """Derivatives of the states at the end of the last step by those after its measurements, (n, n)."""
        return np.eye(len(self.x)) if self._timeless else self._motion.transition()

    def _pose(self, end: float, stillness: Stillness, nis: float, degrees: int) -> Pose:
        covariance = self.p.take(self._covariance)
        x, y, heading, speed, yaw_rate = self._of_pose(self.x)
        self._fastest = max(self._fastest, abs(speed))
        if self.silences.turned:
            covariance[:2, :2] += self._swung()
        return Pose(end, x, y, heading, speed, yaw_rate, covariance, stillness, nis, degrees)

    def _pass_silence(self, end: float, windows: int) -> Pose:
        """Nothing was heard of any wheel: what vehicles do meanwhile."""
        stood = self.windows - windows - self._rested < _JUST_NOW
        seconds = windows * WINDOW
        passed, turned = self._over_silence.advance(self.x, self.p, seconds, agility(self._fastest), stood)
        place = self.x[self._at[X]], self.x[self._at[Y]]
        forces = [wheel.rest.force for wheel in self.wheels]
        self.silences.begin(end - seconds, end, place, turned, forces if stood else None)
        for wheel in self.wheels:
            wheel.unhear(windows)
            wheel.rest.forget()
        if self.keep:
            after = list(self.x), self.p.copy()
            self.kept = Kept(*after, [], *after, self._swung(), passed)
        self._timeless = True
        return self._pose(end, Stillness.MOVING, 0.0, 0)

    def _swung(self) -> Array:
        """(2, 2) m² of x and y that headings lost in silences add beyond their derivatives."""
        added = np.zeros((2, 2))
        for x, y, variance in self.silences.turned:
            added += swung(self.x[self._at[X]] - x, self.x[self._at[Y]] - y, variance)
        return added

    def innovation(self, told: Position) -> Innovation:
        """What a position at the end of the last window would say that is new."""
        rows = position.measure(self.x, self._at, told)
        z = np.array([row[0] for row in rows])
        h = np.array([self._derivatives(row, self._at) for row in rows])
        ph = self.p @ h.T
        s = h @ ph + np.diag([row[1] for row in rows])
        return Innovation(z, s, ph, float(z @ np.linalg.solve(s, z)))

    def fix(self, new: Innovation) -> None:
        """Works a position in."""
        weight = np.linalg.solve(new.s, new.ph.T)
        self._correct(new.z @ weight, new.ph @ weight)

    def estimate(self, node: str | None, entry: Entry) -> Quantity:
        """Value and 1 sigma of an entry.

        Of the vehicle (node None) or of a node and its wheel, facing left.
        """
        at = self._at if node is None else next(wheel.at for wheel in self.wheels if wheel.name == node)
        place = at[entry]
        return Quantity(self.x[place], math.sqrt(max(0.0, self.p[place, place])))

    # -- prediction -----------------------------------------------------------------------------------------

    def _predict_rates(self, pairs: Pairs, told: bool) -> None:
        """Speed goes on with the mean forward acceleration that is felt; the rest is noise.

        told: whether another odometer tells what the wheels do.
        """
        x, p = self.x, self.p
        speed, yaw_rate = self._at[SPEED], self._at[YAW_RATE]
        force = forward_force(pairs, x)
        if force is not None:
            force -= x[self._at[SLOPE]]
            x[speed] += min(_HARDEST, max(-_HARDEST, force)) * WINDOW
        heard = [wheel for wheel, window in pairs if window.missing < UNHEARD]
        shows_turning = told or len(heard) == 2 or any(wheel.joined for wheel in heard)
        along, turning = _SPEED_STEP**2, _YAW_STEP**2
        if not shows_turning:
            free_along, turning = window_walk(agility(self._fastest))
            along = along if heard or told else free_along
        p[speed, speed] += along
        p[yaw_rate, yaw_rate] += turning

    def _stand(self, stillness: Stillness) -> None:
        """Speed and yaw rate of a vehicle that stands.

        They are free in each window, so that what is measured takes the place of what was believed.
        """
        for row in zero_velocity.measure(self.x, self._at, stillness):
            residual, variance, derivatives = row
            for entry in derivatives:
                place = self._at[entry]
                self.x[place] += residual
                self._renew(place, variance)

    def _renew(self, place: int, variance: float) -> None:
        """Begins a state anew, without memory."""
        self.p[place, :] = 0.0
        self.p[:, place] = 0.0
        self.p[place, place] = variance
        self._renewed.append(place)

    def _carried(self, wheel: Wheel, window: Window) -> Window:
        found, renewed = carried(self.x, self.p, wheel, window)
        self._renewed += renewed
        return found

    # -- what else the windows say --------------------------------------------------------------------------

    def _feel_spin(self, wheel: Wheel, window: Window) -> None:
        wheel.view.look(self.x, window, resting=False)
        row = centripetal.measure(wheel.view, self.config.noise)
        if row is None:
            return
        self._work_in(row, wheel.at)

    def _roll(self, speeds: tuple[float, float]) -> None:
        """What another odometer says of the wheels' surfaces."""
        for side, speed in zip((1.0, -1.0), speeds, strict=True):
            contact = 0.5 * side * self.config.track_width
            self._work_in(surface_speed.measure(self.x, self._at, side, contact, speed), self._at)

    def _work_in(self, row: Row, at: Mapping[Entry, int]) -> None:
        """One row alone; one that stands out has the weight of one that just does not."""
        residual, variance, _ = row
        h = self._derivatives(row, at)
        ph = self.p @ h
        s = max(float(h @ ph) + variance, residual**2 / two_wheels.GATE**2)
        self._correct(ph * (residual / s), np.outer(ph, ph / s))

    def _derivatives(self, row: Row, at: Mapping[Entry, int]) -> Array:
        """A row of the Jacobian, (n,)."""
        h = np.zeros(len(self.x))
        for entry, value in row[2].items():
            h[at[entry]] = value
        return h

    def _correct(self, change: Array, drop: Array) -> None:
        self.x = [a + b for a, b in zip(self.x, change.tolist(), strict=True)]
        self.p -= drop

    def _watch(self, pairs: Pairs, rates: Sequence[float], yaws: Sequence[float]) -> None:
        for (wheel, window), rate in zip(pairs, rates, strict=True):
            wheel.turned += abs(rate) * WINDOW
            wheel.forwards += rate * WINDOW
            wheel.clipped += window.spin_clipped > 0.0
            if (
                wheel.moving < _ENOUGH
                and abs(rate) > _TURNING
                and wheel.joined
                and window.force_clipped == 0.0
            ):
                angle = self.x[wheel.at[WHEEL_ANGLE]] + 0.5 * rate * WINDOW
                wheel.upright += (window.force * cmath.exp(1j * angle)).real / (STANDARD_GRAVITY * WINDOW)
                wheel.moving += 1
        if len(pairs) == 2 and self.agreement.open and all(wheel.joined for wheel in self.wheels):
            self._compare(rates, 0.5 * (yaws[0] + yaws[1]))

    def _compare(self, rates: Sequence[float], yaw_rate: float) -> None:
        """Two wheels with the yaw rate that their gyros feel: is one mounted the other way round?"""
        speeds = [rate * wheel.geometry.radius for rate, wheel in zip(rates, self.wheels, strict=True)]
        left, right = speeds if self.wheels[0].geometry.side > 0 else speeds[::-1]
        blamed = self.agreement.add(yaw_rate, left, right)
        if blamed is not None:
            # Up to here the wrong wheel may have been believed.
            lost = 2.0 * max(abs(way) for way in self.agreement.travel)
            for place in (self._at[X], self._at[Y]):
                self.p[place, place] += lost * lost
            for wheel in self.wheels:
                wheel.trusted &= blamed != two_wheels.BOTH and blamed != wheel.geometry.side
