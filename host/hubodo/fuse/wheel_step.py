"""One step of the wheel filter, an error-state Kalman filter: a window of each wheel in, a pose out."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from hubodo.fuse import phase, two_wheels
from hubodo.fuse.phase import ROWS, VEHICLE_STATES, WHEEL_STATES
from hubodo.fuse.wheel_config import WheelConfig
from hubodo.fuse.wheel_state import Wheel, start
from hubodo.fuse.windows import WINDOW, Window
from hubodo.fuse.zero_velocity import Stillness
from hubodo.model.frames import STANDARD_GRAVITY, Array

# How far speed (m/s) and yaw rate (rad/s) may step from window to window: so far that what is measured
# decides.
_SPEED_STEP, _YAW_STEP = 0.5, 0.5
# How still a vehicle is that stands still: 1 sigma of speed and yaw rate.
_STILL = {Stillness.RESTING: (1e-3, 1e-4), Stillness.LOITERING: (0.03, 0.03)}
_EXCESS_STEP = 2.0
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
        self._walk = begin.walk * WINDOW
        self._count = len(self.wheels)
        places = [phase.jacobian_places(index, self._count) for index in range(self._count)]
        rows = np.array([row for one, _ in places for row in one])
        columns = np.array([column for _, one in places for column in one])
        self._flat = rows * len(self.x) + columns
        self._jacobian = np.zeros((self._count * ROWS, len(self.x)))
        # Only these states move within a window; their rows of the transition are all that is kept of it.
        self._pose = np.array([[row * len(self.x) + column for column in POSE_STATES] for row in POSE_STATES])
        self._moved = [phase.X, phase.Y, phase.HEADING, phase.SLOPE]
        self._moved += [wheel.first + phase.ANGLE for wheel in self.wheels]
        self._rows = np.eye(len(self.x))[self._moved]
        self._entries = _transition_places([wheel.first for wheel in self.wheels], len(self.x))
        self.keep = False
        self.kept = Kept([], np.empty(0), [], [], np.empty(0))
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
        if listen:
            for wheel, window in zip(self.wheels, windows, strict=True):
                if not wheel.joined and wheel.heard >= needed and wheel.level != 0j:
                    wheel.join(self.x, self.p, at_begin=False)
                    self._renewed.append(wheel.first + phase.ANGLE)
                wheel.listen(window)
        stillness = self._stillness(windows)
        self._predict_rates(stillness, self._forward_force(windows))
        self._predict_excess(windows)
        prior = (list(self.x), self.p.copy()) if self.keep else None

        values: list[float] = []
        rates: list[float] = []
        yaws: list[float] = []
        # Rolling rows come last, as in phase.row_place.
        residuals: tuple[list[float], list[float]] = ([], [])
        variances: tuple[list[float], list[float]] = ([], [])
        valid: tuple[list[bool], list[bool]] = ([], [])
        vehicle = self.x[:VEHICLE_STATES]
        for wheel, window in zip(self.wheels, windows, strict=True):
            states = self.x[wheel.first : wheel.first + WHEEL_STATES]
            rows, derivatives, rate = phase.wheel_rows(vehicle, states, window, wheel.geometry)
            values += derivatives
            rates.append(rate)
            yaws.append(vehicle[phase.YAW_RATE] + rows[phase.YAW] / WINDOW / math.cos(states[phase.CAMBER]))
            spread = self._row_variances(window, rate, stillness is Stillness.RESTING)
            usable = _usable(wheel, window)
            for index, part in enumerate((slice(0, ROWS - 1), slice(ROWS - 1, ROWS))):
                residuals[index].extend(rows[part])
                variances[index].extend(spread[part])
                valid[index].extend(usable[part])
        self._jacobian.ravel()[self._flat] = values
        nis, degrees = self._update(
            residuals[0] + residuals[1], variances[0] + variances[1], valid[0] + valid[1]
        )
        for wheel, window in zip(self.wheels, windows, strict=True):
            if window.spin_clipped > 0.0 and window.force_clipped == 0.0 and wheel.joined:
                self._feel_spin(wheel, window)
        self._watch(windows, rates, yaws)
        self.steps += 1
        if prior is not None:
            self.kept = Kept(prior[0], prior[1], self._renewed, list(self.x), self.p.copy())
        return self._integrate(number, windows, stillness, nis, degrees)

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

    def _stillness(self, windows: Sequence[Window]) -> Stillness:
        """That of the least still wheel."""
        x, p, found = self.x, self.p, Stillness.RESTING
        for wheel, window in zip(self.wheels, windows, strict=True):
            first = wheel.first
            spin, bx, by = first + phase.SPIN_BIAS, first + phase.BIAS_X, first + phase.BIAS_Y
            sigma = math.sqrt(max(p[spin, spin], p[bx, bx], p[by, by]))
            found = min(found, wheel.rest.stillness(window, x[spin], complex(x[bx], x[by]), sigma))
        return found

    def _forward_force(self, windows: Sequence[Window]) -> float | None:
        """Mean forward acceleration that the accelerometers feel, m/s²; None when none is usable."""
        x, total, count = self.x, 0.0, 0
        for wheel, window in zip(self.wheels, windows, strict=True):
            if wheel.joined and window.missing == 0.0 and window.force_clipped == 0.0:
                first = wheel.first
                rate = (window.spin / WINDOW - x[first + phase.SPIN_BIAS]) / (
                    1.0 + x[first + phase.SPIN_SCALE]
                )
                angle = x[first + phase.ANGLE] + 0.5 * rate * WINDOW
                total += (window.force * cmath.exp(1j * angle)).imag / WINDOW
                count += 1
        return None if count == 0 else min(5.0, max(-5.0, total / count - x[phase.SLOPE]))

    def _predict_rates(self, stillness: Stillness, force: float | None) -> None:
        x, p = self.x, self.p
        if stillness is not Stillness.MOVING:
            x[phase.SPEED] = x[phase.YAW_RATE] = 0.0
            for state, sigma in zip((phase.SPEED, phase.YAW_RATE), _STILL[stillness], strict=True):
                p[state, :] = 0.0
                p[:, state] = 0.0
                p[state, state] = sigma * sigma
            self._renewed += [phase.SPEED, phase.YAW_RATE]
            return
        if force is not None:
            x[phase.SPEED] += force * WINDOW
        p[phase.SPEED, phase.SPEED] += _SPEED_STEP**2
        p[phase.YAW_RATE, phase.YAW_RATE] += _YAW_STEP**2

    def _predict_excess(self, windows: Sequence[Window]) -> None:
        """The spin that a clipped gyro did not see is a state while it clips, and nothing else."""
        for wheel, window in zip(self.wheels, windows, strict=True):
            place = wheel.first + phase.EXCESS
            if window.spin_clipped > 0.0:
                self.p[place, place] += (_EXCESS_STEP * window.spin_clipped) ** 2
            elif self.p[place, place] > 0.0:
                self.p[place, :] = 0.0
                self.p[:, place] = 0.0
                self.x[place] = 0.0
                self._renewed.append(place)

    # -- update ---------------------------------------------------------------------------------------------

    def _row_variances(self, window: Window, rate: float, resting: bool) -> tuple[float, ...]:
        noise, t = self.config.noise, WINDOW
        gyro = noise.gyro**2 * t
        accel = noise.accel**2 * t
        if resting:
            still = (0.02 * t) ** 2
            return gyro, gyro, accel + still, accel + still, 2e-5**2
        shaken = noise.flex**2 * window.axial_variance * t * t
        shake = noise.vibration**2 * window.axial_variance
        push = 2.0 * STANDARD_GRAVITY / 10.0 if window.spin_clipped > 0.0 else noise.push
        road = noise.road**2 * abs(rate) * self.config.radius * t + 1e-8
        share = 1.0 + 1e4 * window.missing
        return (
            (gyro + shaken) * share,
            (gyro + shaken + (noise.roll * t) ** 2) * share,
            (accel + (push**2 + shake) * t * t) * share,
            (accel + (noise.sway**2 + shake) * t * t) * share,
            road * share,
        )

    def _update(self, residuals: list[float], variances: list[float], valid: list[bool]) -> tuple[float, int]:
        complete = all(valid)
        if complete:
            h, z, r = self._jacobian, np.array(residuals), np.array(variances)
        elif any(valid):
            pick = np.flatnonzero(valid)
            h, z, r = self._jacobian[pick], np.array(residuals)[pick], np.array(variances)[pick]
        else:
            return 0.0, 0
        ph = self.p @ h.T
        bare = h @ ph
        whiten = _whitening(bare, r)
        white = whiten @ z
        if white @ white > two_wheels.GATE**2:
            sigma = 1.0 / whiten.diagonal()
            r, slipping = two_wheels.robust_variances(white, sigma, z, r, complete, self._count)
            if slipping is not None:
                self.wheels[slipping].slips += 1
            whiten = _whitening(bare, r)
            white = whiten @ z
        root = whiten @ ph.T
        self._correct(white @ root, root.T @ root)
        return float(white @ white), len(z)

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
        self.p = self.p - drop

    # -- to the end of the window
    # -----------------------------------------------------------------------------

    def _integrate(
        self, number: int, windows: Sequence[Window], stillness: Stillness, nis: float, degrees: int
    ) -> Pose:
        x, t, noise = self.x, WINDOW, self.config.noise
        speed, yaw_rate = x[phase.SPEED], x[phase.YAW_RATE]
        turn = yaw_rate * t
        course = x[phase.HEADING] + 0.5 * turn
        # The chord of an arc, to the second order of its angle.
        short = 1.0 - turn * turn / 24.0
        chord = speed * t * short
        cos, sin = math.cos(course), math.sin(course)
        x[phase.X] += chord * cos
        x[phase.Y] += chord * sin
        x[phase.HEADING] += turn
        fade = math.exp(-t / noise.slope_time)
        x[phase.SLOPE] *= fade
        half = 0.5 * t * chord
        values = [
            -chord * sin,
            t * short * cos,
            -half * sin,
            chord * cos,
            t * short * sin,
            half * cos,
            t,
            fade,
        ]
        for wheel, window in zip(self.wheels, windows, strict=True):
            values += self._turn_wheel(wheel, window, yaw_rate)
        rows, p = self._rows, self.p
        rows.ravel()[self._entries] = values
        p[self._moved] = rows @ p
        p[:, self._moved] = p @ rows.T
        diagonal = p.ravel()[:: len(x) + 1]
        diagonal += self._walk
        rolled = noise.lateral**2 * abs(chord)
        p[phase.X, phase.X] += rolled * sin * sin
        p[phase.Y, phase.Y] += rolled * cos * cos
        p[phase.X, phase.Y] -= rolled * sin * cos
        p[phase.Y, phase.X] -= rolled * sin * cos
        p[phase.SLOPE, phase.SLOPE] += noise.slope**2 * (1.0 - fade * fade)
        for wheel, window in zip(self.wheels, windows, strict=True):
            if window.missing > 0.0:
                p[wheel.first, wheel.first] += (window.missing * t) ** 2
        if self.steps % 16 == 0:
            self.p = 0.5 * (p + p.T)
        end = (number + 1) * WINDOW
        place = (x[phase.X], x[phase.Y], x[phase.HEADING])
        return Pose(end, *place, speed, yaw_rate, self.p.take(self._pose), stillness, nis, degrees)

    def _turn_wheel(self, wheel: Wheel, window: Window, yaw_rate: float) -> tuple[float, ...]:
        """The wheel angle to the end of the window; its derivatives in the order of `_transition_places`."""
        x, t, first, side = self.x, WINDOW, wheel.first, wheel.geometry.side
        scale = 1.0 + x[first + phase.SPIN_SCALE]
        seen = (window.spin / t - x[first + phase.SPIN_BIAS]) / scale
        lean = x[first + phase.CAMBER]
        sin = math.sin(lean)
        rate = seen + x[first + phase.EXCESS] - side * yaw_rate * sin
        x[first + phase.ANGLE] = math.remainder(x[first + phase.ANGLE] + rate * t, 2.0 * math.pi)
        return -seen / scale * t, -t / scale, t, -side * yaw_rate * math.cos(lean) * t, -side * sin * t

    def transition(self) -> Array:
        """Derivatives of the states at the end of the last window by those at its beginning, (n, n)."""
        whole = np.eye(len(self.x))
        whole[self._moved] = self._rows
        return whole

    def _watch(self, windows: Sequence[Window], rates: Sequence[float], yaws: Sequence[float]) -> None:
        for wheel, window, rate in zip(self.wheels, windows, rates, strict=True):
            wheel.turned += abs(rate) * WINDOW
            wheel.forwards += rate * WINDOW
            wheel.clipped += window.spin_clipped > 0.0
            if wheel.moving < 300 and abs(rate) > 1.0 and wheel.joined and window.force_clipped == 0.0:
                angle = self.x[wheel.first] + 0.5 * rate * WINDOW
                wheel.upright += (window.force * cmath.exp(1j * angle)).real / (STANDARD_GRAVITY * WINDOW)
                wheel.moving += 1
        if self._count == 2 and self.agreement.open and all(wheel.joined for wheel in self.wheels):
            speeds = [rate * wheel.geometry.radius for rate, wheel in zip(rates, self.wheels, strict=True)]
            ordered = speeds if self.wheels[0].geometry.side > 0 else speeds[::-1]
            blamed = self.agreement.add(0.5 * (yaws[0] + yaws[1]), ordered[0], ordered[1])
            if blamed is not None:
                # Up to here the wrong wheel may have been believed.
                lost = 2.0 * max(abs(way) for way in self.agreement.travel)
                self.p[phase.X, phase.X] += lost * lost
                self.p[phase.Y, phase.Y] += lost * lost
                for wheel in self.wheels:
                    wheel.trusted &= blamed != two_wheels.BOTH and blamed != wheel.geometry.side


def _transition_places(firsts: list[int], size: int) -> Array:
    """Places in the kept rows of the transition of all numbers that change from window to window."""
    heading, speed, yaw = phase.HEADING, phase.SPEED, phase.YAW_RATE
    places = [
        (0, heading),
        (0, speed),
        (0, yaw),
        (1, heading),
        (1, speed),
        (1, yaw),
        (2, yaw),
        (3, phase.SLOPE),
    ]
    for index, first in enumerate(firsts):
        own = (phase.SPIN_SCALE, phase.SPIN_BIAS, phase.EXCESS, phase.CAMBER)
        places += [(4 + index, first + state) for state in own]
        places.append((4 + index, yaw))
    return np.array([row * size + column for row, column in places])


def _usable(wheel: Wheel, window: Window) -> tuple[bool, ...]:
    heard = wheel.joined and window.missing < 0.5
    across = heard and window.across_clipped == 0.0
    force = heard and window.force_clipped == 0.0
    spin = heard and wheel.trusted
    return across, across, force, force and window.spin_clipped == 0.0, spin


def _whitening(bare: Array, variances: Array) -> Array:
    """Inverse of the lower Cholesky factor of the innovation covariance: makes each innovation, given those
    before it, a number of sigma 1. (Solving with the factor instead wakes the threads of BLAS, a hundred
    times slower.)"""
    s = bare.copy()
    diagonal = s.ravel()[:: len(s) + 1]
    diagonal += variances
    factor, _ = dpotrf(s, lower=1, clean=1)
    inverse: Array
    inverse, _ = dtrtri(factor, lower=1)
    return inverse
