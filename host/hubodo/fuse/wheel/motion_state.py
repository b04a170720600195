"""Standstill detection of one wheel, from changes, so that an unknown bias does not hide a standstill."""

from __future__ import annotations

import cmath
import itertools
import math
import statistics
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from hubodo.fuse.wheel.thresholds import GATE_SIGMA, MANOEUVRE_WINDOWS, STANDSTILL_FORCE_SIGMA
from hubodo.fuse.wheel.window import WINDOW_S, WINDOWS_PER_SECOND, Window

_STANDSTILL_WINDOWS = WINDOWS_PER_SECOND
"""Windows in which a wheel must stand still: longer than a wheel pauses when it reverses."""

_ROCKING_WINDOWS = MANOEUVRE_WINDOWS
"""Windows in which rocking is detected: hands that rock a wheel move it to and fro in them."""

_MIN_SHAKING = 0.3
"""m/s², 1 sigma of a window's mean force. Less is within the declared noise of a vehicle at rest."""


class MotionState(IntEnum):
    """Motion of a wheel or of the vehicle.

    MOVING: driving. ROCKING: to and fro about one place, as with hands on the rims. STANDSTILL: no motion.
    """

    MOVING = 0
    ROCKING = 1
    STANDSTILL = 2


@dataclass(frozen=True, slots=True)
class StandstillLimits:
    """Limits of standstill detection: above an idle engine or idle hands, below the slowest drive.

    Attributes
    ----------
    rate : rad/s, mean rate over 1 s less bias, in addition to 3 sigma of bias and mean.
    gyro_spread : rad/s, standard deviation of the gyro within a window; its noise and a shaking engine
    included.
    rocking_rate, rocking_gyro_spread : the same for rocking, over 2 s.
    rocking_force_change : m/s², change of the specific force of a window within these 2 s.
    max_rocking_rate : rad/s of any single window, in addition to 3 sigma of the biases.
    """

    rate: float = 0.005
    gyro_spread: float = 0.1
    rocking_rate: float = 0.02
    rocking_force_change: float = 0.8
    rocking_gyro_spread: float = 0.25
    max_rocking_rate: float = 0.12


class _QuietWindow(NamedTuple):
    """A window with little motion: mean rates less biases, rad/s, mean force, m/s², variance of the gyro."""

    spin: float
    across: complex
    force: complex
    variance: float


@dataclass
class StandstillDetector:
    """Standstill detector: 1 s without rotation of gravity and without a mean rate beyond bias and noise.

    A steadily rolling wheel rotates gravity. A wheel on the spot about which the vehicle pivots does not,
    but shows a rate across the axle, which is distinguished from a bias as far as the bias is known. Engine
    vibration and gyro noise do not change the means. `noise` is the variance of a window's mean rate of one
    axis, (rad/s)², as measured at the last standstill, `force_noise` that of its mean force, (m/s²)², counted
    as if windows were independent.
    """

    limits: StandstillLimits = field(default_factory=StandstillLimits)
    noise: float = 0.0
    force_noise: float = 0.0
    _quiet_windows: deque[_QuietWindow] = field(default_factory=lambda: deque(maxlen=_ROCKING_WINDOWS))
    _standstill_windows: list[_QuietWindow] = field(default_factory=list)
    _noise_history: deque[float] = field(default_factory=lambda: deque(maxlen=_STANDSTILL_WINDOWS))
    _shaking_history: deque[tuple[float, float]] = field(
        default_factory=lambda: deque(maxlen=_STANDSTILL_WINDOWS)
    )

    def estimate_initial_noise(self, windows: Sequence[Window]) -> None:
        """Estimate the noise from the first windows if they look like a standstill."""
        it = [w for w in windows if w.missing == 0.0 and w.gyro_variance < self.limits.gyro_spread**2]
        if len(it) == len(windows) > 1:
            self.noise = _rate_noise([(w.spin / WINDOW_S, w.raw_across / WINDOW_S) for w in it])
            force_noise = long_run_variance([w.raw_force / WINDOW_S for w in it])
            self.force_noise = force_noise if force_noise > _MIN_SHAKING**2 else 0.0

    def force_noise_of(self, window: Window) -> float:
        """Return the variance of a window's mean force from engine vibration, (m/s²)²; 0 while rolling."""
        is_slow = abs(window.spin) < self.limits.max_rocking_rate * WINDOW_S
        return self.force_noise if is_slow else 0.0

    @property
    def force(self) -> complex:
        """Return the mean specific force ax + i ay of the last second of standstill, m/s².

        It is 0 before the first standstill.
        """
        return _mean_force(self._standstill_windows) if self._standstill_windows else 0j

    def clear(self) -> None:
        """Discard the history after a gap."""
        self._quiet_windows.clear()
        self._noise_history.clear()
        self._shaking_history.clear()
        self._standstill_windows = []

    def detect(self, window: Window, spin_bias: float, across_bias: complex, sigma: float) -> MotionState:
        """Return the motion state at the end of this window.

        spin_bias: rad/s, bias of gz. across_bias: rad/s, bias of gx + i gy. sigma: rad/s, largest 1 sigma of
        these.
        """
        limits, margin = self.limits, GATE_SIGMA * sigma
        spin = window.spin / WINDOW_S - spin_bias
        if window.missing > 0.0 or abs(spin) >= limits.max_rocking_rate + margin:
            # Early exit, taken in most windows of a drive.
            self._quiet_windows.clear()
            self._shaking_history.clear()
            return MotionState.MOVING
        across = window.raw_across / WINDOW_S - across_bias
        if (
            abs(across) >= limits.max_rocking_rate + margin
            or window.gyro_variance >= limits.rocking_gyro_spread**2
        ):
            self._quiet_windows.clear()
            self._shaking_history.clear()
            return MotionState.MOVING
        self._quiet_windows.append(
            _QuietWindow(spin, across, window.raw_force / WINDOW_S, window.gyro_variance)
        )
        if len(self._quiet_windows) < _STANDSTILL_WINDOWS:
            return MotionState.MOVING
        last = list(self._quiet_windows)[-_STANDSTILL_WINDOWS:]
        spread = sum(it.variance for it in last) / _STANDSTILL_WINDOWS
        gravity_change = abs(
            _mean_force(last[: _STANDSTILL_WINDOWS // 2]) - _mean_force(last[_STANDSTILL_WINDOWS // 2 :])
        )
        is_zero, noise = _is_rate_zero(last, limits.rate + margin)
        self._measure_shaking(noise)
        if (
            is_zero
            and gravity_change < GATE_SIGMA * STANDSTILL_FORCE_SIGMA
            and spread < limits.gyro_spread**2
        ):
            self._standstill_windows = last
            self._noise_history.append(noise)
            # Values of a second ago, because the newest windows may contain the start of a drive.
            self.noise = self._noise_history[0]
            return MotionState.STANDSTILL
        self._noise_history.clear()
        rocking = (
            len(self._quiet_windows) == _ROCKING_WINDOWS
            and _is_rate_zero(list(self._quiet_windows), limits.rocking_rate + margin)[0]
        )
        first = self._quiet_windows[0].force
        force_change = limits.rocking_force_change + GATE_SIGMA * math.sqrt(_force_scatter(last))
        if rocking and all(abs(it.force - first) < force_change for it in self._quiet_windows):
            return MotionState.ROCKING
        return MotionState.MOVING

    def _measure_shaking(self, rate_noise: float) -> None:
        """Update the force noise from engine vibration while the wheel hardly turns.

        Values of a second ago are used: the newest windows may contain the start of a drive.
        """
        # Gravity that rotates on a creeping wheel is not vibration.
        angles = itertools.accumulate(it.spin * WINDOW_S for it in self._quiet_windows)
        force_noise = long_run_variance(
            [it.force * cmath.exp(1j * angle) for it, angle in zip(self._quiet_windows, angles, strict=True)]
        )
        self._shaking_history.append((rate_noise, force_noise))
        rate_noise, force_noise = self._shaking_history[0]
        is_shaking = force_noise > _MIN_SHAKING**2
        self.force_noise = force_noise if is_shaking else 0.0
        if is_shaking:
            self.noise = max(self.noise, rate_noise)


def _is_rate_zero(past: Sequence[_QuietWindow], limit: float) -> tuple[bool, float]:
    """Return True if the mean rates are zero, and the noise variance, (rad/s)².

    Zero means within `limit`, rad/s, and 3 sigma of noise; the newest window is tested too. Noise is
    estimated from successive differences, so that a wheel that starts to turn does not count as noise.
    """
    count, newest = len(past), past[-1]
    spin = sum(it.spin for it in past) / count
    across = sum(it.across for it in past) / count
    noise = _rate_noise([(it.spin, it.across) for it in past])
    is_zero = max(abs(spin), abs(across)) < limit + GATE_SIGMA * math.sqrt(noise / count)
    is_zero &= max(abs(newest.spin), abs(newest.across)) < 2.0 * limit + 4.0 * math.sqrt(noise)
    return is_zero, noise


def _rate_noise(rates: Sequence[tuple[float, complex]]) -> float:
    """Return the variance of one axis from successive differences (von Neumann 1941), (rad/s)².

    A trend does not contribute.
    """
    pairs = itertools.pairwise(rates)
    squares = sum(
        (spin - spin_before) ** 2 + abs(across - across_before) ** 2
        for (spin_before, across_before), (spin, across) in pairs
    )
    return squares / (6.0 * (len(rates) - 1))


def _force_scatter(past: Sequence[_QuietWindow]) -> float:
    """Return the variance of one axis of the force from successive differences, (m/s²)².

    The median is not affected by a single step. Squared differences of two axes are exponential: their median
    is their mean times ln 2.
    """
    squares = [abs(it.force - before.force) ** 2 for before, it in itertools.pairwise(past)]
    return statistics.median(squares) / (4.0 * math.log(2.0))


def long_run_variance(forces: Sequence[complex]) -> float:
    """Return the variance of one axis that independent windows with the same sum would have, (m/s²)².

    Engine vibration aliased to a low frequency correlates successive windows. So this is the variance of a
    window times 1 + 2 sum of the autocorrelations, summed while they are positive (Geyer 1992).
    """
    count = len(forces)
    mean = sum(forces) / count
    centred = [force - mean for force in forces]
    total = sum(abs(it) ** 2 for it in centred)
    growth = 1.0
    for lag in range(1, count // 2):
        product = sum((a * b.conjugate()).real for a, b in zip(centred, centred[lag:], strict=False))
        if product <= 0.0:
            break
        growth += 2.0 * product / total
    return 0.5 * growth * total / (count - 1)


def _mean_force(past: list[_QuietWindow]) -> complex:
    return sum(it.force for it in past) / len(past)
