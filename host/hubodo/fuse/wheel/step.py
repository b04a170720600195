"""One step of the wheel filter, an error-state Kalman filter: a window of each wheel in, a pose out."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel import two_wheels
from hubodo.fuse.wheel.clipping import unclipped
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import (
    ACCEL_BIAS_X,
    ACCEL_BIAS_Y,
    EXCESS,
    HEADING,
    LEVER_ARM_X,
    LEVER_ARM_Y,
    SLOPE,
    SPEED,
    WHEEL_ANGLE,
    YAW_RATE,
    Entry,
    X,
    Y,
)
from hubodo.fuse.wheel.measurements import Row, centripetal, position, zero_velocity
from hubodo.fuse.wheel.measurements.position import Position
from hubodo.fuse.wheel.prediction import forward_force, least_still
from hubodo.fuse.wheel.preintegration import WINDOW, Window
from hubodo.fuse.wheel.propagation import WheelMotion
from hubodo.fuse.wheel.state import Wheel, initial_state
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.update import Pairs, WheelUpdate

_SPEED_STEP, _YAW_STEP = 0.5, 0.5
"""m/s and rad/s by which speed and yaw rate may step from window to window.

So far that what is measured decides. Estimated.
"""

_EXCESS_PUSH = 3.0
"""m/s² by which the spin beyond a clipped gyro may change from window to window: hard driving. Estimated."""

_EXCESS_SEEN = 0.15
"""m/s by which the way of a window may be off what gravity shows of the spin: braking that begins or ends in
it. Estimated."""

_LOST_ANGLE = 1.0
"""rad, 1 sigma of the wheel angle over a clipped window, from which on gravity's phase may be a turn off."""

_ASTRAY = 3
"""Windows in a row with gravity elsewhere; a hole in the road fills one. Estimated."""

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

POSE = (X, Y, HEADING, SPEED, YAW_RATE)


class Pose(NamedTuple):
    """End of a window.

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

    renewed: the states that the step began anew, without memory.
    """

    prior_x: list[float]
    prior_p: Array
    renewed: list[int]
    x: list[float]
    p: Array


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
        self.steps = 0
        self.keep = False
        self.kept = Kept([], np.empty(0), [], [], np.empty(0))
        self._update = WheelUpdate(config, begin.columns)
        self._motion = WheelMotion(config, begin)
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
        for wheel in self.wheels:
            if wheel.heard > 0 and wheel.level != 0j:
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

    def step(self, windows: Sequence[Window], number: int, listen: bool, needed: int) -> Pose:
        """Window `number` of each wheel.

        listen: look for the angle of wheels that were not heard, in `needed` windows.
        """
        self._renewed = []
        pairs = tuple(zip(self.wheels, windows, strict=True))
        if listen:
            for wheel, window in pairs:
                if not wheel.joined and wheel.heard >= needed and wheel.level != 0j:
                    self._renewed += wheel.join(self.x, self.p, at_begin=False)
                wheel.listen(window)
        pairs = tuple((wheel, self._carried(wheel, window)) for wheel, window in pairs)
        stillness = least_still(pairs, self.x, self.p)
        if stillness is Stillness.MOVING:
            self._predict_rates(pairs)
        else:
            self._stand(stillness)
        prior = (list(self.x), self.p.copy()) if self.keep else None
        found = self._update.work_in(self.x, self.p, pairs, stillness)
        self.x, self.p = found.x, found.p
        for wheel, window in pairs:
            if window.all_clipped and window.force_clipped == 0.0 and not wheel.follower.seen:
                self._feel_spin(wheel, window)
            if window.all_clipped and wheel.joined:
                self._keep_upright(wheel, window)
        self._watch(pairs, found.rates, found.yaws)
        self.steps += 1
        if prior is not None:
            self.kept = Kept(prior[0], prior[1], self._renewed, list(self.x), self.p.copy())
        self._motion.advance(self.x, self.p, pairs)
        if self.steps % _SYMMETRIC == 0:
            self.p[:] = 0.5 * (self.p + self.p.T)
        end, covariance = (number + 1) * WINDOW, self.p.take(self._covariance)
        x, y, heading, speed, yaw_rate = self._of_pose(self.x)
        return Pose(end, x, y, heading, speed, yaw_rate, covariance, stillness, found.nis, found.degrees)

    def transition(self) -> Array:
        """Derivatives of the states at the end of the last window by those at its beginning, (n, n)."""
        return self._motion.transition()

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

    def _predict_rates(self, pairs: Pairs) -> None:
        """Speed goes on with the mean forward acceleration that is felt; the rest is noise."""
        x, p = self.x, self.p
        speed, yaw_rate = self._at[SPEED], self._at[YAW_RATE]
        force = forward_force(pairs, x)
        if force is not None:
            force -= x[self._at[SLOPE]]
            x[speed] += min(_HARDEST, max(-_HARDEST, force)) * WINDOW
        p[speed, speed] += _SPEED_STEP**2
        p[yaw_rate, yaw_rate] += _YAW_STEP**2

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
        """The window turned by the spin that it is believed to have.

        The spin that a clipped gyro did not see is a state while it clips, and nothing else: in each window
        anew, about what gravity shows of it.
        """
        x, p, at, follower = self.x, self.p, wheel.at, wheel.follower
        place, angle = at[EXCESS], at[WHEEL_ANGLE]
        step = _EXCESS_PUSH * WINDOW / wheel.geometry.radius
        if window.missing >= 1.0:
            # What is not heard begins where it is heard; what was followed until then has turned on unseen.
            if wheel.joined and follower.following:
                wheel.forget()
            follower.rest()
            x[place] = 0.0
            self._renew(place, 0.0)
            return window
        if not window.all_clipped:
            follower.roll(window)
            if window.spin_clipped > 0.0 or p[place, place] > 0.0:
                # Beyond the limit for less than a window it is not far beyond.
                x[place] = 0.0
                self._renew(place, (step * window.spin_clipped) ** 2)
            return unclipped(window, 0.0)
        arm = complex(x[at[LEVER_ARM_X]], x[at[LEVER_ARM_Y]])
        follower.follow(window, arm, complex(x[at[ACCEL_BIAS_X]], x[at[ACCEL_BIAS_Y]]))
        if follower.seen:
            x[place] = follower.excess
            self._renew(place, (_EXCESS_SEEN / wheel.geometry.radius) ** 2)
        else:
            # Where gravity does not show it, the other measurements have; after a gap, what was found.
            known = p[place, place] > 0.0
            x[place] = x[place] + follower.slope * WINDOW if known else follower.excess
            p[place, place] += step * step
        far = p[angle, angle] + WINDOW * p[angle, place] + 0.25 * WINDOW**2 * p[place, place]
        if wheel.joined and far > _LOST_ANGLE**2:
            wheel.lost += 1
            wheel.forget()
        return unclipped(window, x[place], follower.slope)

    # -- what else the windows say --------------------------------------------------------------------------

    def _feel_spin(self, wheel: Wheel, window: Window) -> None:
        wheel.view.look(self.x, window, resting=False)
        row = centripetal.measure(wheel.view, self.config.noise)
        if row is None:
            return
        residual, variance, _ = row
        h = self._derivatives(row, wheel.at)
        ph = self.p @ h
        s = max(float(h @ ph) + variance, residual**2 / two_wheels.GATE**2)
        self._correct(ph * (residual / s), np.outer(ph, ph / s))

    def _keep_upright(self, wheel: Wheel, window: Window) -> None:
        """Begins the wheel angle anew where gravity has long been elsewhere: half a turn off, or more.

        The way may be off by that turn.
        """
        at, change = wheel.at, wheel.follower.slope * wheel.geometry.radius
        wheel.view.look(self.x, window, resting=False)
        off = cmath.phase(wheel.view.force / complex(STANDARD_GRAVITY, change))
        wheel.astray = wheel.astray + 1 if wheel.follower.seen and abs(off) > _LOST_ANGLE else 0
        if wheel.astray < _ASTRAY:
            return
        wheel.astray, wheel.lost = 0, wheel.lost + 1
        self.x[at[WHEEL_ANGLE]] -= off
        self._renew(at[WHEEL_ANGLE], WHEEL_ANGLE.prior**2)
        course, turn = self.x[self._at[HEADING]], 2.0 * math.pi * wheel.geometry.radius
        way = np.array([turn * math.cos(course), turn * math.sin(course)])
        places = [self._at[X], self._at[Y]]
        self.p[np.ix_(places, places)] += np.outer(way, way)

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
