"""One step of the wheel filter, an error-state Kalman filter: a window of each wheel in, a pose out."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel import phase, two_wheels
from hubodo.fuse.wheel.config import WheelConfig
from hubodo.fuse.wheel.phase import VEHICLE_STATES, WHEEL_STATES
from hubodo.fuse.wheel.preintegration import WINDOW, Window
from hubodo.fuse.wheel.propagation import WheelMotion
from hubodo.fuse.wheel.state import Wheel, start
from hubodo.fuse.wheel.update import Pairs, WheelUpdate
from hubodo.fuse.wheel.zero_velocity import Stillness

# How far speed (m/s) and yaw rate (rad/s) may step from window to window: so far that what is measured
# decides.
_SPEED_STEP, _YAW_STEP = 0.5, 0.5
# How still a vehicle is that stands still: 1 sigma of speed and yaw rate.
_STILL = {Stillness.RESTING: (1e-3, 1e-4), Stillness.LOITERING: (0.03, 0.03)}
_EXCESS_STEP = 2.0
# m/s²; no wheel drives or brakes a vehicle harder.
_FORCE = 5.0
POSE_STATES = [phase.X, phase.Y, phase.HEADING, phase.SPEED, phase.YAW_RATE]


class Pose(NamedTuple):
    """End of a window. t: s; x, y: m; heading: rad, unwrapped; speed: m/s and yaw_rate: rad/s, means over the
    window. covariance: (5, 5) of x, y, heading, speed, yaw_rate. still: whether the vehicle stood still.
    nis, degrees: squared innovations of the step over their variance, and how many there were."""

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
    """Both sides of a step's measurements: states and covariance before and after; renewed: the states that
    the step began anew, without memory."""

    prior_x: list[float]
    prior_p: Array
    renewed: list[int]
    x: list[float]
    p: Array


class WheelStep:
    """State vector, covariance and the step that carries both through a window.

    x: list of the states of `phase`, vehicle first. p: their covariance. Copies (copy.deepcopy) go their
    own ways.
    """

    def __init__(self, config: WheelConfig) -> None:
        begin = start(config)
        self.config, self.x, self.p, self.wheels = config, begin.x, begin.p, begin.wheels
        self.agreement = two_wheels.Agreement(config.track_width)
        self.steps = 0
        self.keep = False
        self.kept = Kept([], np.empty(0), [], [], np.empty(0))
        self._update = WheelUpdate(config)
        self._motion = WheelMotion(config, self.wheels, begin.walk)
        self._pose = np.array([[row * len(self.x) + column for column in POSE_STATES] for row in POSE_STATES])
        self._renewed: list[int] = []

    def begin(self, windows: Sequence[Sequence[Window]]) -> None:
        """Look at the first windows as a whole for the wheel angles; `step` follows with each of them."""
        for row in windows:
            for wheel, window in zip(self.wheels, row, strict=True):
                wheel.listen(window)
        for wheel in self.wheels:
            if wheel.heard > 0 and wheel.level != 0j:
                wheel.join(self.x, self.p, at_begin=True)

    def step(self, windows: Sequence[Window], number: int, listen: bool, needed: int) -> Pose:
        """Window `number` of each wheel. listen: look for the angle of wheels that were not heard, in
        `needed` windows."""
        self._renewed = []
        pairs = tuple(zip(self.wheels, windows, strict=True))
        if listen:
            for wheel, window in pairs:
                if not wheel.joined and wheel.heard >= needed and wheel.level != 0j:
                    wheel.join(self.x, self.p, at_begin=False)
                    self._renewed.append(wheel.first + phase.ANGLE)
                wheel.listen(window)
        stillness = self._stillness(pairs)
        if stillness is Stillness.MOVING:
            self._predict_rates(pairs)
        else:
            self._hold_rates(stillness)
        self._predict_excess(pairs)
        prior = (list(self.x), self.p.copy()) if self.keep else None
        found = self._update.work_in(self.x, self.p, pairs, stillness is Stillness.RESTING)
        self.x, self.p = found.x, found.p
        for wheel, window in pairs:
            if window.spin_clipped > 0.0 and window.force_clipped == 0.0 and wheel.joined:
                self._feel_spin(wheel, window)
        self._watch(pairs, found.rates, found.yaws)
        self.steps += 1
        if prior is not None:
            self.kept = Kept(prior[0], prior[1], self._renewed, list(self.x), self.p.copy())
        self._motion.advance(self.x, self.p, pairs)
        if self.steps % 16 == 0:
            self.p[:] = 0.5 * (self.p + self.p.T)
        x = self.x
        place, motion = (x[phase.X], x[phase.Y], x[phase.HEADING]), (x[phase.SPEED], x[phase.YAW_RATE])
        covariance = self.p.take(self._pose)
        return Pose((number + 1) * WINDOW, *place, *motion, covariance, stillness, found.nis, found.degrees)

    def transition(self) -> Array:
        """Derivatives of the states at the end of the last window by those at its beginning, (n, n)."""
        return self._motion.transition()

    def fix(self, x: float, y: float, sigma: float) -> float:
        """A position from elsewhere at the end of the last window, m; its squared innovation in sigma (2
        numbers)."""
        z = np.array([x - self.x[phase.X], y - self.x[phase.Y]])
        ph = self.p[:, [phase.X, phase.Y]]
        s = ph[[phase.X, phase.Y]] + np.eye(2) * sigma**2
        weight = np.linalg.solve(s, np.column_stack([ph.T, z]))
        self._correct(z @ weight[:, :-1], ph @ weight[:, :-1])
        return float(z @ weight[:, -1])

    def estimate(self, node: str | None, state: int) -> tuple[float, float]:
        """Value and 1 sigma of a state of `phase`: of the vehicle (node None) or of a node's wheel."""
        first = 0 if node is None else next(wheel.first for wheel in self.wheels if wheel.name == node)
        return self.x[first + state], math.sqrt(max(0.0, self.p[first + state, first + state]))

    # -- prediction -----------------------------------------------------------------------------------------

    def _stillness(self, pairs: Pairs) -> Stillness:
        """That of the least still wheel."""
        x, p, found = self.x, self.p, Stillness.RESTING
        for wheel, window in pairs:
            first = wheel.first
            spin, bx, by = first + phase.SPIN_BIAS, first + phase.BIAS_X, first + phase.BIAS_Y
            sigma = math.sqrt(max(p[spin, spin], p[bx, bx], p[by, by]))
            still = wheel.rest.stillness(window, x[spin], complex(x[bx], x[by]), sigma)
            if still < found:
                found = still
        return found

    def _predict_rates(self, pairs: Pairs) -> None:
        """Speed goes on with the mean forward acceleration that usable accelerometers feel; the rest is
        noise."""
        x, p, total, count = self.x, self.p, 0.0, 0
        for wheel, window in pairs:
            if wheel.joined and window.missing == 0.0 and window.force_clipped == 0.0:
                first = wheel.first
                seen = window.spin / WINDOW - x[first + phase.SPIN_BIAS]
                rate = seen / (1.0 + x[first + phase.SPIN_SCALE])
                angle = x[first + phase.ANGLE] + 0.5 * rate * WINDOW
                total += (window.force * cmath.exp(1j * angle)).imag / WINDOW
                count += 1
        if count:
            force = total / count - x[phase.SLOPE]
            x[phase.SPEED] += min(_FORCE, max(-_FORCE, force)) * WINDOW
        p[phase.SPEED, phase.SPEED] += _SPEED_STEP**2
        p[phase.YAW_RATE, phase.YAW_RATE] += _YAW_STEP**2

    def _hold_rates(self, stillness: Stillness) -> None:
        """Speed and yaw rate of a vehicle that stands."""
        x, p = self.x, self.p
        x[phase.SPEED] = x[phase.YAW_RATE] = 0.0
        for state, sigma in zip((phase.SPEED, phase.YAW_RATE), _STILL[stillness], strict=True):
            p[state, :] = 0.0
            p[:, state] = 0.0
            p[state, state] = sigma * sigma
        self._renewed += [phase.SPEED, phase.YAW_RATE]

    def _predict_excess(self, pairs: Pairs) -> None:
        """The spin that a clipped gyro did not see is a state while it clips, and nothing else."""
        for wheel, window in pairs:
            place = wheel.first + phase.EXCESS
            if window.spin_clipped > 0.0:
                self.p[place, place] += (_EXCESS_STEP * window.spin_clipped) ** 2
            elif self.p[place, place] > 0.0:
                self.p[place, :] = 0.0
                self.p[:, place] = 0.0
                self.x[place] = 0.0
                self._renewed.append(place)

    # -- what else the windows say --------------------------------------------------------------------------

    def _feel_spin(self, wheel: Wheel, window: Window) -> None:
        states = self.x[wheel.first : wheel.first + WHEEL_STATES]
        row = phase.centripetal_row(self.x[:VEHICLE_STATES], states, window, wheel.geometry)
        if row is None:
            return
        h = np.zeros(len(self.x))
        for state, value in row[1].items():
            h[wheel.first + state] = value
        ph = self.p @ h
        s = float(h @ ph) + (1.0 + self.config.noise.vibration**2 * window.axial_variance) * WINDOW**2
        s = max(s, row[0] ** 2 / two_wheels.GATE**2)
        self._correct(ph * (row[0] / s), np.outer(ph, ph / s))

    def _correct(self, change: Array, drop: Array) -> None:
        self.x = [a + b for a, b in zip(self.x, change.tolist(), strict=True)]
        self.p -= drop

    def _watch(self, pairs: Pairs, rates: Sequence[float], yaws: Sequence[float]) -> None:
        for (wheel, window), rate in zip(pairs, rates, strict=True):
            wheel.turned += abs(rate) * WINDOW
            wheel.forwards += rate * WINDOW
            wheel.clipped += window.spin_clipped > 0.0
            if wheel.moving < 300 and abs(rate) > 1.0 and wheel.joined and window.force_clipped == 0.0:
                angle = self.x[wheel.first] + 0.5 * rate * WINDOW
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
            self.p[phase.X, phase.X] += lost * lost
            self.p[phase.Y, phase.Y] += lost * lost
            for wheel in self.wheels:
                wheel.trusted &= blamed != two_wheels.BOTH and blamed != wheel.geometry.side
