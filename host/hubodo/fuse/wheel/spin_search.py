"""Search for the spin of a wheel beyond the range of its gyro, from the rotation of gravity.

Gravity rotates in the accelerometers across the axle as fast as the wheel turns, in the opposite sense. The
integrals of a window (`preintegration.py`) are derotated by the measured rate. Where that is clipped they
are recomputed from the samples, derotated by the measured rate plus the predicted rate beyond range, so that
the measurements are linearised about the present states.
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

_MAX_RATE_BEYOND = 240.0
"""rad/s beyond range that is searched, 8 times a gyro of 2000 deg/s."""

_MAX_GRAVITY_RATIO = 1.5
"""Ratio of the rotating force and gravity up to which it is accepted as gravity, either way. Estimated."""

_MIN_SEARCH_SAMPLES = 25
"""Samples for a search, a quarter of a second at 104 Hz; fewer do not separate gravity from the lever arm."""

_TRACKED_WINDOWS = 4
"""Windows tracked together: braking is constant for 0.4 s, in which gravity rotates by half a turn or more.
"""

_FIRST_TRACKED_WINDOWS = 3
"""Windows before tracking a spin that was measured until then; fewer do not separate rate from slope. A
searched spin is known better than these windows tell and waits for `_TRACKED_WINDOWS`.
"""

_SEARCH_GRID = np.linspace(-1.0, 1.0, 9)

_RATE_TOLERANCE = 2.0
"""rad/s by which a spin may lie below the saturation limit: a few percent of scale, bias and search error. A
saturated gyro bounds the rate from below. Estimated.
"""

_TRACKING_RANGE = 8.0
"""rad/s around the predicted rate that is searched: half of the resolution of `_TRACKED_WINDOWS`."""


def rederotate_window(window: Window, excess: float, slope: float = 0.0) -> Window:
    """Return a window with its integrals derotated by the measured rate plus `excess`, rad/s at its middle.

    slope: rad/s², change of the excess. `spin` stays as measured.
    """
    samples = window.samples
    if samples is None:
        return window
    rate_change = (window.rate_end - window.rate_start) / WINDOW_S + slope
    across = carrier = force = rate_carrier = lever = 0j
    for weight, time, rate, angle, w, f, _ in zip(*samples, strict=True):
        rate += excess + slope * time
        # Both ends of the window are equally far from its middle in angle.
        angle += excess * time + 0.5 * slope * (time * time - 0.25 * WINDOW_S * WINDOW_S)
        weighted_rotation = weight * cmath.exp(1j * angle)
        across += weighted_rotation * w
        carrier += weighted_rotation
        force += weighted_rotation * f
        rate_carrier += weighted_rotation * rate
        # The same sum as for the force: with few samples a turn it differs from the integral.
        lever += weighted_rotation * complex(-rate * rate, rate_change)
    return window._replace(
        across=across,
        carrier=carrier,
        force=force,
        rate_carrier=rate_carrier,
        lever=lever,
        rate_start=window.rate_start - 0.5 * slope * WINDOW_S,
        rate_end=window.rate_end + 0.5 * slope * WINDOW_S,
    )


class SpinEstimate(NamedTuple):
    """Spin found in consecutive clipped windows.

    Attributes
    ----------
    start_angle, end_angle : rad, wheel angle at the start of the first and the end of the last window.
    excess, excess_end : rad/s beyond range, means over the first and the last window.
    steady : mean of the terms that are fixed in the node.
    """

    start_angle: float
    end_angle: float
    excess: float
    excess_end: float
    steady: NodeFixedTerms


def find_spin(windows: Sequence[Window], radius: float) -> SpinEstimate | None:
    """Return the spin at which gravity rotates in clipped windows; None if none is significant. radius: m."""
    sample_set = _Samples.of(windows)
    if sample_set is None:
        return None
    sign = math.copysign(1.0, sum(w.spin for w in windows))
    # A tyre on a dry road accelerates by 1 g at most.
    max_slope = STANDARD_GRAVITY / radius
    rates, slopes = (
        sign * np.arange(-_RATE_TOLERANCE, _MAX_RATE_BEYOND, 1.0),
        np.linspace(-max_slope, max_slope, 21),
    )
    all_samples, sample_set = sample_set, sample_set.without(3)
    chirp = sample_set.best(rates, slopes)
    for fine_step in (0.25, 0.05):
        offsets = np.arange(-5.0, 6.0) * fine_step
        chirp = sample_set.best(chirp.excess + offsets, chirp.slope + 0.1 * max_slope * offsets)
    if not chirp.is_gravity:
        return None
    first, last = windows[0], windows[-1]
    start_time, end_time = (
        first.number * WINDOW_S - sample_set.centre,
        (last.number + 1) * WINDOW_S - sample_set.centre,
    )
    angle = -cmath.phase(chirp.amplitude) + math.atan2(radius * chirp.slope, STANDARD_GRAVITY)

    def theta(t: float, carrier: float) -> float:
        return angle + carrier + chirp.excess * t + 0.5 * chirp.slope * t * t

    return SpinEstimate(
        theta(start_time, first.clock_angle - 0.5 * first.spin),
        theta(end_time, last.clock_angle + 0.5 * last.spin),
        chirp.excess + chirp.slope * (start_time + 0.5 * WINDOW_S),
        chirp.excess + chirp.slope * (end_time - 0.5 * WINDOW_S),
        all_samples.steady(chirp, radius),
    )


class _Chirp(NamedTuple):
    """Amplitude, m/s², of a rotating force with a rate beyond range, rad/s, that changes by slope, rad/s²."""

    excess: float
    slope: float
    amplitude: complex

    @property
    def is_gravity(self) -> bool:
        return 1.0 / _MAX_GRAVITY_RATIO < abs(self.amplitude) / STANDARD_GRAVITY < _MAX_GRAVITY_RATIO


class _Samples(NamedTuple):
    """Samples of consecutive windows.

    t: s from `centre`, (N,); carried: rad, measured carrier angle; rate, across: rad/s; force: m/s². basis:
    (N, k) orthonormal polynomials already removed from the force.
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
        """Return the samples of clipped windows without a clipped force; None if there are too few."""
        clipped = [(w, w.samples) for w in windows if w.samples is not None and w.missing == 0.0]
        is_valid = np.array([flag for _, samples in clipped for flag in samples.force_in_range], bool)
        if np.count_nonzero(is_valid) < _MIN_SEARCH_SAMPLES:
            return None
        centre = 0.5 * (clipped[0][0].number + clipped[-1][0].number + 1) * WINDOW_S
        t = np.concatenate([np.array(s.time) + ((w.number + 0.5) * WINDOW_S - centre) for w, s in clipped])
        carried = np.concatenate([np.array(s.angle) + w.clock_angle for w, s in clipped])
        rate, across, force = (np.concatenate([s[row] for _, s in clipped])[is_valid] for row in (2, 4, 5))
        return _Samples(t[is_valid], carried[is_valid], rate, across, force, centre, np.empty(0))

    def without(self, order: int) -> _Samples:
        """Remove a polynomial of time with `order` coefficients, for bias and lever arm."""
        basis, _ = np.linalg.qr(self.t[:, None] ** np.arange(order))
        return self._replace(force=self.force - basis @ (basis.T @ self.force), basis=basis)

    def best(self, rates: Array, slopes: Array, sign: float = 0.0) -> _Chirp:
        """Return the chirp with the smallest residual among all these rates and slopes.

        sign: of the limit at which the gyro was saturated all the time; rates inside of it are no
        candidates. 0.0 otherwise. The force across the axle is g e^(-iθ): maximum-likelihood estimate of a
        complex chirp in white noise (Abatzoglou 1986).
        """
        t, count = self.t, len(self.t)
        derotation = np.exp(-1j * (self.carried + 0.5 * slopes[:, None] * t * t))
        # The basis is already removed from the force, so the overlap of a tone with it only reduces its
        # size.
        projections = np.column_stack([self.basis, self.force.conj()])
        columns = (derotation[:, :, None] * projections).transpose(1, 0, 2).reshape(count, -1)
        projected = np.exp(-1j * np.outer(rates, t)) @ columns
        projected = projected.reshape(len(rates), len(slopes), projections.shape[1])
        residual_size = np.maximum(count - np.sum(np.abs(projected[:, :, :-1]) ** 2, axis=2), 0.1 * count)
        fit = projected[:, :, -1].conj() / residual_size
        half_duration = 0.5 * (t[-1] - t[0])
        fit[sign * rates[:, None] - abs(sign) * half_duration * np.abs(slopes) < -_RATE_TOLERANCE] = 0.0
        power = np.abs(fit) ** 2 * residual_size
        rate, slope = np.unravel_index(int(np.argmax(power)), power.shape)
        return _Chirp(float(rates[rate]), float(slopes[slope]), complex(fit[rate, slope]))

    def steady(self, chirp: _Chirp, radius: float) -> NodeFixedTerms:
        """Return the means of force and rates after removing what rotates with the chirp; radius: m."""
        t, spin = self.t, self.rate + chirp.excess + chirp.slope * self.t
        rotation = np.exp(-1j * (self.carried + chirp.excess * t + 0.5 * chirp.slope * t * t))
        basis = np.column_stack([np.ones(len(t)), rotation])
        signals = np.column_stack([self.force, self.across])
        fit = np.linalg.lstsq(basis, signals, rcond=None)[0]
        # A wheel bounces on its tyre at some 10 Hz, a cycle per window, so windows count as independent.
        residual_variance = (
            0.5 * np.mean(np.abs(signals - basis @ fit) ** 2, axis=0) * WINDOW_S / (t[-1] - t[0])
        )
        lever_factor = complex(-float(np.mean(spin * spin)), chirp.slope)
        force, rate = (complex(value) for value in fit[0])
        return NodeFixedTerms(
            force,
            rate,
            float(residual_variance[0]),
            float(residual_variance[1]),
            float(np.mean(spin)),
            lever_factor,
            radius,
        )


@dataclass
class SpinTracker:
    """Tracks the rate beyond range of one wheel from window to window.

    radius: m. excess: rad/s, mean over the newest window; slope: rad/s². is_observed: True if gravity showed
    it.
    """

    radius: float
    excess: float = 0.0
    slope: float = 0.0
    is_observed: bool = False
    _windows: deque[Window] = field(default_factory=lambda: deque(maxlen=_TRACKED_WINDOWS))
    _min_windows: int = _FIRST_TRACKED_WINDOWS

    def record_unclipped(self, window: Window) -> None:
        """Record a window whose gyro is in range."""
        self._windows.clear()
        self.excess, self.is_observed, self._min_windows = 0.0, False, _FIRST_TRACKED_WINDOWS
        self.slope = (window.rate_end - window.rate_start) / WINDOW_S

    @property
    def is_tracking(self) -> bool:
        """Return True if the newest window was clipped."""
        return bool(self._windows)

    def pause(self) -> None:
        """Skip a window without samples; the last estimate is kept."""
        self._windows.clear()
        self.is_observed = False

    def initialise(self, excess: float, slope: float) -> None:
        """Start from a search, for the window before the next."""
        self.excess, self.slope, self._min_windows = excess, slope, _TRACKED_WINDOWS

    def track_window(self, window: Window, arm: complex, bias: complex) -> None:
        """Process a window that is clipped all the time; arm: m, bias: m/s², of the accelerometers across."""
        self.excess += self.slope * WINDOW_S
        self._windows.append(window)
        self.is_observed = False
        if len(self._windows) < self._min_windows:
            return
        sample_set = _Samples.of(self._windows)
        if sample_set is None:
            # Accelerations do not grow without bound.
            self.slope *= 0.5
            return
        newest = (window.number + 0.5) * WINDOW_S - sample_set.centre
        max_slope, sign = STANDARD_GRAVITY / self.radius, math.copysign(1.0, window.spin)
        chirp = _Chirp(self.excess - self.slope * newest, self.slope, 0j)
        for rate_range, fine_step in (
            (_TRACKING_RANGE, max_slope),
            (2.0, 0.25 * max_slope),
            (0.4, 0.05 * max_slope),
        ):
            rate = sample_set.rate + chirp.excess + chirp.slope * sample_set.t
            lever = arm * (1j * chirp.slope - rate * rate)
            chirp = (
                sample_set._replace(force=sample_set.force - bias - lever)
                .without(2)
                .best(chirp.excess + rate_range * _SEARCH_GRID, chirp.slope + fine_step * _SEARCH_GRID, sign)
            )
        if chirp.is_gravity:
            self.is_observed, self.slope = True, chirp.slope
            self.excess = chirp.excess + chirp.slope * newest
        else:
            self.slope *= 0.5
