"""Spin beyond the gyro about the axle: windows turned by the spin they are believed to have, and its search.

What the gyro does not show, gravity does: in the accelerometers across the axle it turns backwards as fast as
the wheel turns. A window's integrals (preintegration.py) are turned by the measured rate; where that is
clipped they are made again from its samples, turned by the measured rate and the excess that the filter
predicts, so that the derivatives of the measurements hold about the present states.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.measurements.steady import NodeFixedTerms
from hubodo.fuse.wheel.window import WINDOW_S, Window

_FASTEST = 240.0
"""rad/s of excess that is looked for, 8 times a gyro of 2000 deg/s."""

_HARDEST = 10.0
"""m/s²; no tyre brakes or drives harder: gravity's grip on a dry road."""

_GRAVITY = (0.6, 1.5)
"""Share of gravity that what turns may have; what is outside is no gravity. Estimated."""

_FEWEST = 25
"""Samples for a search, a quarter of a second at 104 Hz; fewer cannot tell gravity from the lever arm."""

_SPAN = 4
"""Windows that are followed together: braking is steady for 0.4 s, gravity turns by half a turn and more."""

_SOON = 3
"""Windows after which a spin that was measured until then is followed; of fewer, spin and slope are not told
apart. One that was searched for is better known than by these, and waits for all of `_SPAN`."""

_GRID = np.linspace(-1.0, 1.0, 9)

_BELOW = 2.0
"""rad/s by which the spin may seem to lie below what the gyro stands at: a few percent of scale, a bias, and
what a search is off. A gyro that stands at its end feels no less than that. Estimated."""

_SHAKES = 0.1
"""s after which a wheel that bounces on its tyre does so otherwise: a cycle of 10 Hz, which goes round in the
accelerometers as fast as a wheel at 20 m/s, and so hardly averages out. Estimated."""

_NEAR = 8.0
"""rad/s around the predicted excess that are looked at: half of what tells two spins apart in `_SPAN`."""


def rederotate_window(window: Window, excess: float, slope: float = 0.0) -> Window:
    """A window with its integrals turned by the measured rate and `excess`, rad/s at its middle.

    slope: rad/s², by which the excess changes. `spin` stays what was measured.
    """
    samples = window.samples
    if samples is None:
        return window
    change = (window.rate_end - window.rate_start) / WINDOW_S + slope
    across = carrier = force = swing = lever = 0j
    for weight, time, rate, angle, w, f, _ in zip(*samples, strict=True):
        rate += excess + slope * time
        # Both ends of the window lie as far from its middle in angle.
        angle += excess * time + 0.5 * slope * (time * time - 0.25 * WINDOW_S * WINDOW_S)
        turn = weight * cmath.exp(1j * angle)
        across += turn * w
        carrier += turn
        force += turn * f
        swing += turn * rate
        # The same sum as that of the force: with few samples a turn it is not quite the integral.
        lever += turn * complex(-rate * rate, change)
    return window._replace(
        across=across,
        carrier=carrier,
        force=force,
        swing=swing,
        lever=lever,
        rate_start=window.rate_start - 0.5 * slope * WINDOW_S,
        rate_end=window.rate_end + 0.5 * slope * WINDOW_S,
    )


class SpinEstimate(NamedTuple):
    """What windows in a row show of a clipped spin.

    begin, end: rad, the wheel angle at the beginning of the first and the end of the last window. excess,
    excess_end: rad/s, means in the first and the last window. steady: what does not turn meanwhile.
    """

    start_angle: float
    end_angle: float
    excess: float
    excess_end: float
    steady: NodeFixedTerms


def find_spin(windows: Sequence[Window], radius: float) -> SpinEstimate | None:
    """The spin by which gravity turns in clipped windows; None where none stands out. radius: m."""
    taken = _Samples.of(windows)
    if taken is None:
        return None
    sign = math.copysign(1.0, sum(w.spin for w in windows))
    hardest = _HARDEST / radius
    rates, slopes = sign * np.arange(-_BELOW, _FASTEST, 1.0), np.linspace(-hardest, hardest, 21)
    whole, taken = taken, taken.without(3)
    found = taken.best(rates, slopes)
    for finer in (0.25, 0.05):
        around = np.arange(-5.0, 6.0) * finer
        found = taken.best(found.excess + around, found.slope + 0.1 * hardest * around)
    if not found.is_gravity:
        return None
    first, last = windows[0], windows[-1]
    behind, ahead = first.number * WINDOW_S - taken.centre, (last.number + 1) * WINDOW_S - taken.centre
    angle = -cmath.phase(found.amplitude) + math.atan2(radius * found.slope, STANDARD_GRAVITY)

    def theta(t: float, carrier: float) -> float:
        return angle + carrier + found.excess * t + 0.5 * found.slope * t * t

    return SpinEstimate(
        theta(behind, first.clock_angle - 0.5 * first.spin),
        theta(ahead, last.clock_angle + 0.5 * last.spin),
        found.excess + found.slope * (behind + 0.5 * WINDOW_S),
        found.excess + found.slope * (ahead - 0.5 * WINDOW_S),
        whole.steady(found, radius),
    )


class _Chirp(NamedTuple):
    """Amplitude, m/s², of what turns with an excess, rad/s, that changes by slope, rad/s²."""

    excess: float
    slope: float
    amplitude: complex

    @property
    def is_gravity(self) -> bool:
        return _GRAVITY[0] < abs(self.amplitude) / STANDARD_GRAVITY < _GRAVITY[1]


class _Samples(NamedTuple):
    """Samples of windows in a row.

    t: s from `centre`, (N,); carried: rad; rate, across: rad/s; force: m/s².
    """

    t: Array
    carried: Array
    rate: Array
    across: Array
    force: Array
    centre: float
    basis: Array

    @staticmethod
    def of(windows: Sequence[Window]) -> _Samples | None:
        """Those of clipped windows, less those with a clipped force; None where too few are left."""
        heard = [(w, w.samples) for w in windows if w.samples is not None and w.missing == 0.0]
        felt = np.array([flag for _, samples in heard for flag in samples.force_in_range], bool)
        if np.count_nonzero(felt) < _FEWEST:
            return None
        centre = 0.5 * (heard[0][0].number + heard[-1][0].number + 1) * WINDOW_S
        t = np.concatenate([np.array(s.time) + ((w.number + 0.5) * WINDOW_S - centre) for w, s in heard])
        carried = np.concatenate([np.array(s.angle) + w.clock_angle for w, s in heard])
        rate, across, force = (np.concatenate([s[row] for _, s in heard])[felt] for row in (2, 4, 5))
        return _Samples(t[felt], carried[felt], rate, across, force, centre, np.empty(0))

    def without(self, order: int) -> _Samples:
        """Less what is a polynomial of time with so many coefficients: bias and lever arm."""
        basis, _ = np.linalg.qr(self.t[:, None] ** np.arange(order))
        return self._replace(force=self.force - basis @ (basis.T @ self.force), basis=basis)

    def best(self, rates: Array, slopes: Array, sign: float = 0.0) -> _Chirp:
        """What leaves least of the force, of all these rates and slopes.

        sign: of the limit at which the gyro stood all the time: what lies inside of it is no candidate, and
        no gravity where nothing else is left; 0.0 where it did not. The force across the axle is
        g e^(-i theta): the maximum-likelihood estimate of a complex chirp in white noise (Abatzoglou 1986).
        """
        t, count = self.t, len(self.t)
        bent = np.exp(-1j * (self.carried + 0.5 * slopes[:, None] * t * t))
        # The force has nothing of the basis in it: what a tone has, counts for its size alone.
        against = np.column_stack([self.basis, self.force.conj()])
        columns = (bent[:, :, None] * against).transpose(1, 0, 2).reshape(count, -1)
        seen = np.exp(-1j * np.outer(rates, t)) @ columns
        seen = seen.reshape(len(rates), len(slopes), against.shape[1])
        size = np.maximum(count - np.sum(np.abs(seen[:, :, :-1]) ** 2, axis=2), 0.1 * count)
        fit = seen[:, :, -1].conj() / size
        reach = 0.5 * (t[-1] - t[0])
        fit[sign * rates[:, None] - abs(sign) * reach * np.abs(slopes) < -_BELOW] = 0.0
        power = np.abs(fit) ** 2 * size
        rate, slope = np.unravel_index(int(np.argmax(power)), power.shape)
        return _Chirp(float(rates[rate]), float(slopes[slope]), complex(fit[rate, slope]))

    def steady(self, found: _Chirp, radius: float) -> NodeFixedTerms:
        """What is left of force and rates when what goes round with the chirp is taken out; radius: m."""
        t, spin = self.t, self.rate + found.excess + found.slope * self.t
        turns = np.exp(-1j * (self.carried + found.excess * t + 0.5 * found.slope * t * t))
        basis = np.column_stack([np.ones(len(t)), turns])
        both = np.column_stack([self.force, self.across])
        fit = np.linalg.lstsq(basis, both, rcond=None)[0]
        left = 0.5 * np.mean(np.abs(both - basis @ fit) ** 2, axis=0) * _SHAKES / (t[-1] - t[0])
        square = complex(-float(np.mean(spin * spin)), found.slope)
        force, rate = (complex(value) for value in fit[0])
        return NodeFixedTerms(
            force, rate, float(left[0]), float(left[1]), float(np.mean(spin)), square, radius
        )


@dataclass
class SpinTracker:
    """Follows the excess of one wheel from window to window.

    radius: m. excess: rad/s, mean over the newest window, slope: rad/s². seen: whether gravity showed it.
    """

    radius: float
    excess: float = 0.0
    slope: float = 0.0
    is_observed: bool = False
    _past: deque[Window] = field(default_factory=lambda: deque(maxlen=_SPAN))
    _wait: int = _SOON

    def record_unclipped(self, window: Window) -> None:
        """A window whose gyro shows the spin."""
        self._past.clear()
        self.excess, self.is_observed, self._wait = 0.0, False, _SOON
        self.slope = (window.rate_end - window.rate_start) / WINDOW_S

    @property
    def is_tracking(self) -> bool:
        """Whether the newest window was clipped."""
        return bool(self._past)

    def pause(self) -> None:
        """A window that was not heard: what was found of the spin is kept."""
        self._past.clear()
        self.is_observed = False

    def initialise(self, excess: float, slope: float) -> None:
        """Found by a search; as of the window before the next."""
        self.excess, self.slope, self._wait = excess, slope, _SPAN

    def track_window(self, window: Window, arm: complex, bias: complex) -> None:
        """A window that is clipped all the time; arm: m, bias: m/s², of the accelerometers across."""
        self.excess += self.slope * WINDOW_S
        self._past.append(window)
        self.is_observed = False
        if len(self._past) < self._wait:
            return
        taken = _Samples.of(self._past)
        if taken is None:
            # Nobody drives harder and harder.
            self.slope *= 0.5
            return
        newest = (window.number + 0.5) * WINDOW_S - taken.centre
        hardest, sign = _HARDEST / self.radius, math.copysign(1.0, window.spin)
        found = _Chirp(self.excess - self.slope * newest, self.slope, 0j)
        for wide, finer in ((_NEAR, hardest), (2.0, 0.25 * hardest), (0.4, 0.05 * hardest)):
            rate = taken.rate + found.excess + found.slope * taken.t
            lever = arm * (1j * found.slope - rate * rate)
            found = (
                taken._replace(force=taken.force - bias - lever)
                .without(2)
                .best(found.excess + wide * _GRID, found.slope + finer * _GRID, sign)
            )
        if found.is_gravity:
            self.is_observed, self.slope = True, found.slope
            self.excess = found.excess + found.slope * newest
        else:
            self.slope *= 0.5
