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

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.gravity_rotation import RATE_TOLERANCE, Chirp, GravitySamples
from hubodo.fuse.wheel.measurements.steady import NodeFixedTerms
from hubodo.fuse.wheel.single_axis_gravity import SingleAxisSamples
from hubodo.fuse.wheel.window import WINDOW_S, Window

MAX_RATE_BEYOND = 240.0
"""rad/s beyond range that is searched, 8 times a gyro of 2000 deg/s."""

_TRACKED_WINDOWS = 4
"""Windows tracked together: braking is constant for 0.4 s, in which gravity rotates by half a turn or more.
A spin that was measured before its first clipped window is tracked from one window fewer on; three separate
rate from slope. Estimated.
"""

_SEARCH_GRID = np.linspace(-1.0, 1.0, 9)

_TRACKING_RANGE = math.pi / (_TRACKED_WINDOWS * WINDOW_S)
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
    for weight, time, rate, angle, w, f in zip(*samples[:6], strict=True):
        rate += excess + slope * time
        # In angle, both ends of the window are equally far from its middle.
        angle += excess * time + 0.5 * slope * (time * time - 0.25 * WINDOW_S * WINDOW_S)
        weighted_rotation = weight * cmath.exp(1j * angle)
        across += weighted_rotation * w
        carrier += weighted_rotation
        force += weighted_rotation * f
        rate_carrier += weighted_rotation * rate
        # A sum like that of the force, not the integral: with few samples a turn the two differ.
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
    """Spin of a wheel over consecutive clipped windows.

    Attributes
    ----------
    start_angle, end_angle : rad, wheel angle at the start of the first and the end of the last window.
    excess, excess_end : rad/s beyond range, means over the first and the last window.
    fixed_terms : means of force and rate that are fixed in the node.
    """

    start_angle: float
    end_angle: float
    excess: float
    excess_end: float
    fixed_terms: NodeFixedTerms


def _collect_samples(windows: Sequence[Window]) -> GravitySamples | SingleAxisSamples | None:
    """Return the samples of windows with a clipped gyro, by axis if an accelerometer is saturated too."""
    collected = GravitySamples.from_windows(windows)
    if collected is None:
        return None
    samples, in_range = collected
    return samples if in_range.all() else SingleAxisSamples.from_samples(samples, in_range)


def _gravity_angle(chirp: Chirp, radius: float) -> float:
    """Return the wheel angle at carrier angle zero, rad; the rotating force also accelerates the hub."""
    return -cmath.phase(chirp.amplitude) + math.atan2(radius * chirp.slope, STANDARD_GRAVITY)


def find_spin(windows: Sequence[Window], radius: float) -> SpinEstimate | None:
    """Return the spin at which gravity rotates in clipped windows; None if none is significant. radius: m."""
    sample_set = _collect_samples(windows)
    if sample_set is None:
        return None
    sign = math.copysign(1.0, sum(w.spin for w in windows))
    # A tyre on a dry road accelerates by 1 g at most.
    max_slope = STANDARD_GRAVITY / radius
    rates, slopes = (
        sign * np.arange(-RATE_TOLERANCE, MAX_RATE_BEYOND, 1.0),
        np.linspace(-max_slope, max_slope, 21),
    )
    all_samples, sample_set = sample_set, sample_set.remove_polynomial(3)
    chirp = sample_set.fit_chirp(rates, slopes)
    for fine_step in (0.25, 0.05):
        offsets = np.arange(-5.0, 6.0) * fine_step
        chirp = sample_set.fit_chirp(chirp.excess + offsets, chirp.slope + 0.1 * max_slope * offsets)
    if not chirp.is_gravity:
        return None
    first, last = windows[0], windows[-1]
    start_time, end_time = (
        first.number * WINDOW_S - sample_set.centre,
        (last.number + 1) * WINDOW_S - sample_set.centre,
    )
    angle = _gravity_angle(chirp, radius)

    def theta(t: float, carrier: float) -> float:
        return angle + carrier + chirp.excess * t + 0.5 * chirp.slope * t * t

    return SpinEstimate(
        theta(start_time, first.clock_angle - 0.5 * first.spin),
        theta(end_time, last.clock_angle + 0.5 * last.spin),
        chirp.excess + chirp.slope * (start_time + 0.5 * WINDOW_S),
        chirp.excess + chirp.slope * (end_time - 0.5 * WINDOW_S),
        all_samples.average_fixed_terms(chirp, radius),
    )


@dataclass
class SpinTracker:
    """A tracker of the rate beyond range of one wheel from window to window.

    radius: m. excess: rad/s, mean over the newest window; slope: rad/s². is_observed: True if gravity showed
    it. gravity_angle: rad, wheel angle at the middle of the newest window if gravity showed it in one axis
    only, else None. unobserved_windows: consecutive clipped windows in which gravity did not show the rate.
    """

    radius: float
    excess: float = 0.0
    slope: float = 0.0
    is_observed: bool = False
    gravity_angle: float | None = None
    unobserved_windows: int = 0
    _windows: deque[Window] = field(default_factory=lambda: deque(maxlen=_TRACKED_WINDOWS))
    _min_windows: int = _TRACKED_WINDOWS - 1

    def record_unclipped(self, window: Window) -> None:
        """Record a window whose gyro is in range."""
        self._windows.clear()
        self.excess, self.is_observed, self._min_windows = 0.0, False, _TRACKED_WINDOWS - 1
        self.unobserved_windows = 0
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
        """Set rate and slope from a search that ended with the previous window."""
        self.excess, self.slope, self._min_windows = excess, slope, _TRACKED_WINDOWS

    def track_window(self, window: Window, arm: complex, bias: complex) -> None:
        """Process a window that is clipped all the time; arm: m, bias: m/s², of the accelerometers across."""
        self.excess += self.slope * WINDOW_S
        self._windows.append(window)
        self.is_observed, self.gravity_angle = False, None
        self.unobserved_windows += 1
        if len(self._windows) < self._min_windows:
            return
        sample_set = _collect_samples(self._windows)
        if sample_set is None:
            # The slope decays, because accelerations do not grow without bound.
            self.slope *= 0.5
            return
        newest = (window.number + 0.5) * WINDOW_S - sample_set.centre
        max_slope, sign = STANDARD_GRAVITY / self.radius, math.copysign(1.0, window.spin)
        chirp = Chirp(self.excess - self.slope * newest, self.slope, 0j)
        for rate_range, fine_step in (
            (_TRACKING_RANGE, max_slope),
            (2.0, 0.25 * max_slope),
            (0.4, 0.05 * max_slope),
        ):
            rate = sample_set.rate + chirp.excess + chirp.slope * sample_set.t
            lever = arm * (1j * chirp.slope - rate * rate)
            chirp = (
                sample_set.subtract_force(bias)
                .subtract_force(lever)
                .remove_polynomial(2)
                .fit_chirp(
                    chirp.excess + rate_range * _SEARCH_GRID, chirp.slope + fine_step * _SEARCH_GRID, sign
                )
            )
        if chirp.is_gravity:
            self.is_observed, self.slope, self.unobserved_windows = True, chirp.slope, 0
            self.excess = chirp.excess + chirp.slope * newest
            if isinstance(sample_set, SingleAxisSamples):
                turned = chirp.excess * newest + 0.5 * chirp.slope * newest * newest
                self.gravity_angle = _gravity_angle(chirp, self.radius) + window.clock_angle + turned
        else:
            self.slope *= 0.5
