"""One step of the wheel filter, an error-state Kalman filter: a window of each wheel in, a pose out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.calibration.file import Quantity
from hubodo.fuse.wheel import two_wheels
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.entries import (
    HEADING,
    SPEED,
    TRACK_WIDTH,
    WHEEL_ANGLE,
    YAW_RATE,
    Entry,
    X,
    Y,
)
from hubodo.fuse.wheel.hindsight import Hindsight, Past
from hubodo.fuse.wheel.measurements import Row, WindowNoise, centripetal, position
from hubodo.fuse.wheel.measurements.position import Position
from hubodo.fuse.wheel.prediction import Prediction, each_still, least_still
from hubodo.fuse.wheel.preintegration import WINDOW, Window
from hubodo.fuse.wheel.propagation import WheelMotion
from hubodo.fuse.wheel.state import Wheel, initial_state
from hubodo.fuse.wheel.stillness import Stillness
from hubodo.fuse.wheel.update import Pairs, Updated, WheelUpdate

_SYMMETRIC = 16
"""Steps after which rounding is taken out of the covariance's symmetry; in so many it is some 1e-15."""

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

    renewed: the states that the step began anew, without memory. carried: the place of the one that it made
    from others before anything else, and the derivatives (n,) of it by them, if any.
    """

    prior_x: list[float]
    prior_p: Array
    renewed: list[int]
    x: list[float]
    p: Array
    carried: tuple[int, Array] | None = None


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

    def __init__(self, config: WheelConfig, slipped: Mapping[int, tuple[bool, ...]] | None = None) -> None:
        """slipped: which wheels spin by themselves, by number of the window; None: that is to be found."""
        begin = initial_state(config)
        self.config, self.x, self.p, self.wheels = config, begin.x, begin.p, begin.wheels
        self.columns, self._at = begin.columns, begin.columns.vehicle
        self.agreement = two_wheels.Agreement(config.track_width)
        self.steps = 0
        self.keep = False
        self.kept = Kept([], np.empty(0), [], [], np.empty(0))
        self.slipped: dict[int, tuple[bool, ...]] = {}
        self._update = WheelUpdate(config, begin.columns)
        self.prediction = Prediction(begin.columns, WindowNoise(config.noise, config.radius))
        self._motion = WheelMotion(config, begin)
        self.pose = [self._at[entry] for entry in POSE]
        self._of_pose = itemgetter(*self.pose)
        self._covariance = np.array(
            [[row * len(self.x) + column for column in self.pose] for row in self.pose]
        )
        self._told = slipped
        self._hindsight = Hindsight(WindowNoise(config.noise, config.radius))
        self.carrying = False
        self._tape = len(self.wheels) == 2 and TRACK_WIDTH not in config.known and not config.told

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

    def step(self, windows: Sequence[Window], number: int, listen: bool, needed: int) -> Pose:
        """Window `number` of each wheel.

        listen: look for the angle of wheels that were not heard, in `needed` windows.
        """
        pairs = tuple(zip(self.wheels, windows, strict=True))
        joined = self._listen(pairs, needed) if listen else []
        if joined:
            self._hindsight.forget()
        stills = each_still(pairs, self.x, self.p)
        if self._told is None:
            self._hindsight.keep(Past(number, pairs, stills, list(self.x), self.p.copy()))
            lost = tuple(wheel.grip.lost for wheel in self.wheels)
        else:
            lost = self._told.get(number, (False,) * len(self.wheels))
        found = self.work_in(number, pairs, stills, lost, joined)
        if self._told is None:
            found = self._hindsight.judge(self, found)
        self._watch(pairs, found)
        self.steps += 1
        self.advance(pairs)
        if self.steps % _SYMMETRIC == 0:
            self.p[:] = 0.5 * (self.p + self.p.T)
        end, covariance = (number + 1) * WINDOW, self.p.take(self._covariance)
        x, y, heading, speed, yaw_rate = self._of_pose(self.x)
        motion = (x, y, heading, speed, yaw_rate)
        return Pose(end, *motion, covariance, found.stillness, found.nis, found.degrees)

    def advance(self, pairs: Pairs) -> None:
        """To the end of a window that has been worked in."""
        self._motion.advance(self.x, self.p, pairs)

    def derivatives(self, row: Row, at: Mapping[Entry, int]) -> Array:
        """A row of the Jacobian, (n,)."""
        h = np.zeros(len(self.x))
        for entry, value in row[2].items():
            h[at[entry]] = value
        return h

    def transition(self) -> Array:
        """Derivatives of the states at the end of the last window by those at its beginning, (n, n)."""
        return self._motion.transition()

    def innovation(self, told: Position) -> Innovation:
        """What a position at the end of the last window would say that is new."""
        rows = position.measure(self.x, self._at, told)
        z = np.array([row[0] for row in rows])
        h = np.array([self.derivatives(row, self._at) for row in rows])
        ph = self.p @ h.T
        s = h @ ph + np.diag([row[1] for row in rows])
        return Innovation(z, s, ph, float(z @ np.linalg.solve(s, z)))

    def fix(self, new: Innovation) -> None:
        """Works a position in."""
        # Going back would lose it.
        self._hindsight.forget()
        weight = np.linalg.solve(new.s, new.ph.T)
        self._correct(new.z @ weight, new.ph @ weight)

    def estimate(self, node: str | None, entry: Entry) -> Quantity:
        """Value and 1 sigma of an entry.

        Of the vehicle (node None) or of a node and its wheel, facing left.
        """
        at = self._at if node is None else next(wheel.at for wheel in self.wheels if wheel.name == node)
        place = at[entry]
        return Quantity(self.x[place], math.sqrt(max(0.0, self.p[place, place])))

    # -- one window -----------------------------------------------------------------------------------------

    def _listen(self, pairs: Pairs, needed: int) -> list[int]:
        """The places of the wheel angles that were found."""
        found = []
        for wheel, window in pairs:
            if not wheel.joined and wheel.heard >= needed and wheel.level != 0j:
                wheel.join(self.x, self.p, at_begin=False)
                found.append(wheel.at[WHEEL_ANGLE])
            wheel.listen(window)
        return found

    def work_in(
        self,
        number: int,
        pairs: Pairs,
        stills: Sequence[Stillness],
        lost: tuple[bool, ...],
        joined: Sequence[int] = (),
    ) -> Updated:
        """Takes the states to a window, and the window into the states.

        lost: which wheels spin by themselves. joined: the states that were begun anew before.
        """
        stillness, carried = Stillness.MOVING, False
        for wheel, away in zip(self.wheels, lost, strict=True):
            wheel.away = away
        if any(lost):
            carried = not any(wheel.rolls(window) for wheel, window in pairs)
            self.slipped[number] = lost
        # The window in which a wheel is back tells how wrong the speed was that was carried until then.
        carry, self.carrying = carried or self.carrying, carried
        if not carry:
            stillness = least_still(stills, lost)
        self.prediction.predict(self.x, self.p, pairs, stillness, carry)
        prior = (list(self.x), self.p.copy()) if self.keep else None
        found = self._update.work_in(self.x, self.p, pairs, stillness)
        self.x, self.p = found.x, found.p
        for wheel, window in pairs:
            if window.spin_clipped > 0.0 and window.force_clipped == 0.0 and wheel.joined:
                self._feel_spin(wheel, window)
        if self._tape:
            self._ask_tape()
        if prior is not None:
            made = self.prediction
            by = None if made.carried is None else (self._at[SPEED], made.carried)
            renewed = [*joined, *made.renewed]
            self.kept = Kept(prior[0], prior[1], renewed, list(self.x), self.p.copy(), by)
        return found

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
            self._correct(ph * (-error / s), np.outer(ph, ph / s))

    # -- what else the windows say --------------------------------------------------------------------------

    def _feel_spin(self, wheel: Wheel, window: Window) -> None:
        wheel.view.look(self.x, window, resting=False)
        row = centripetal.measure(wheel.view, self.config.noise)
        if row is None:
            return
        residual, variance, _ = row
        h = self.derivatives(row, wheel.at)
        ph = self.p @ h
        s = max(float(h @ ph) + variance, residual**2 / two_wheels.GATE**2)
        self._correct(ph * (residual / s), np.outer(ph, ph / s))

    def _correct(self, change: Array, drop: Array) -> None:
        self.x = [a + b for a, b in zip(self.x, change.tolist(), strict=True)]
        self.p -= drop

    def _watch(self, pairs: Pairs, found: Updated) -> None:
        if found.slipping is not None:
            self.wheels[found.slipping].slips += 1
        for (wheel, window), rate in zip(pairs, found.rates, strict=True):
            wheel.watch(window, rate, self.x[wheel.at[WHEEL_ANGLE]])
        if (
            len(pairs) == 2
            and self.agreement.open
            and all(wheel.joined and window.missing == 0.0 for wheel, window in pairs)
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
