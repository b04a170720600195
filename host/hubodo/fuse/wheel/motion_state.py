"""Does a wheel stand still? Judged by what changes, so that an unknown bias does not hide a rest."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from hubodo.fuse.wheel.window import WINDOW_S, Window

_SPAN = 10
"""Windows that are looked at, one second: longer than a wheel pauses when its direction is changed."""

_ROCKING_SPAN = 20
"""Two seconds: hands that rock a wheel go to and fro meanwhile."""


class MotionState(IntEnum):
    """MOVING; ROCKING: rocking about one place, as with hands on the rims; RESTING: nothing moves."""

    MOVING = 0
    ROCKING = 1
    STANDSTILL = 2


@dataclass(frozen=True, slots=True)
class StandstillLimits:
    """Where stillness ends; all estimated: between what idle hands and engines do and the slowest drive.

    rate: rad/s by which mean rates over a second may differ from their biases, beside three sigma of these
    and of the mean. turning: m/s² by which the mean specific force may change from half a second to the next.
    spread: rad/s of the gyro within a window, its own noise and a shaking engine included. Those of rocking
    are `rocking_rate`, over two seconds, `rocking_turning` and `rocking_spread`; no window may turn by more
    than `rocking_peak`, rad/s, beside three sigma of the biases.
    """

    rate: float = 0.005
    force_change: float = 0.06
    gyro_spread: float = 0.1
    rocking_rate: float = 0.02
    rocking_force_change: float = 0.8
    rocking_gyro_spread: float = 0.25
    max_rocking_rate: float = 0.12


class _Quiet(NamedTuple):
    """A window in which little moved: mean rates less biases, rad/s, mean force, m/s², gyro's variance."""

    spin: float
    across: complex
    force: complex
    variance: float


@dataclass
class StandstillDetector:
    """A second without turning of gravity and with no mean rate beyond what bias and noise explain.

    A steadily rolling wheel turns gravity; a wheel on the spot of which the vehicle pivots does not, but it
    shows a rate across the axle: that is told from a bias as far as the bias is known. An engine that shakes
    the vehicle, or a gyro that is noisy, moves no mean. noise: (rad/s)², variance of a window's mean rate, of
    one axis, as the last rest
    showed it.
    """

    limits: StandstillLimits = field(default_factory=StandstillLimits)
    noise: float = 0.0
    _past: deque[_Quiet] = field(default_factory=lambda: deque(maxlen=_ROCKING_SPAN))
    _resting: list[_Quiet] = field(default_factory=list)
    _noises: deque[float] = field(default_factory=lambda: deque(maxlen=_SPAN))

    def estimate_initial_noise(self, windows: Sequence[Window]) -> None:
        """A first look at the noise, where the first windows look like a rest."""
        quiet = [w for w in windows if w.missing == 0.0 and w.gyro_variance < self.limits.gyro_spread**2]
        if len(quiet) == len(windows) > 1:
            self.noise = _noise([(w.spin / WINDOW_S, w.raw_across / WINDOW_S) for w in quiet])

    @property
    def force(self) -> complex:
        """m/s², mean specific force ax + i ay in the last second of rest; 0 where there was none."""
        return _mean_force(self._resting) if self._resting else 0j

    def clear(self) -> None:
        """What was before says nothing of what comes."""
        self._past.clear()
        self._noises.clear()
        self._resting = []

    def detect(self, window: Window, spin_bias: float, across_bias: complex, sigma: float) -> MotionState:
        """How still the wheel has been up to the end of this window.

        spin_bias: rad/s of gz; across_bias: of gx + i gy; sigma: 1 sigma of the least known of them.
        """
        limits, margin = self.limits, 3.0 * sigma
        spin = window.spin / WINDOW_S - spin_bias
        if window.missing > 0.0 or abs(spin) >= limits.max_rocking_rate + margin:
            # Most windows of a drive: nothing further needs a look.
            self._past.clear()
            return MotionState.MOVING
        across = window.raw_across / WINDOW_S - across_bias
        if (
            abs(across) >= limits.max_rocking_rate + margin
            or window.gyro_variance >= limits.rocking_gyro_spread**2
        ):
            self._past.clear()
            return MotionState.MOVING
        self._past.append(_Quiet(spin, across, window.raw_force / WINDOW_S, window.gyro_variance))
        if len(self._past) < _SPAN:
            return MotionState.MOVING
        last = list(self._past)[-_SPAN:]
        spread = sum(quiet.variance for quiet in last) / _SPAN
        turned = abs(_mean_force(last[: _SPAN // 2]) - _mean_force(last[_SPAN // 2 :]))
        held, noise = _holds(last, limits.rate + margin)
        if held and turned < limits.force_change and spread < limits.gyro_spread**2:
            self._resting = last
            self._noises.append(noise)
            # Of a second ago: the newest may hold the beginning of a drive.
            self.noise = self._noises[0]
            return MotionState.STANDSTILL
        self._noises.clear()
        rocking = (
            len(self._past) == _ROCKING_SPAN and _holds(list(self._past), limits.rocking_rate + margin)[0]
        )
        first = self._past[0].force
        if rocking and all(abs(quiet.force - first) < limits.rocking_force_change for quiet in self._past):
            return MotionState.ROCKING
        return MotionState.MOVING


def _holds(past: Sequence[_Quiet], limit: float) -> tuple[bool, float]:
    """Whether the mean rates are zero but for `limit`, rad/s, and three sigma of what is random in them.

    So is the newest of them. What is random shows from one window to the next: a wheel that starts to turn
    does not pass for noise. Besides, the variance of what is random, (rad/s)².
    """
    count, newest = len(past), past[-1]
    spin = sum(quiet.spin for quiet in past) / count
    across = sum(quiet.across for quiet in past) / count
    noise = _noise([(quiet.spin, quiet.across) for quiet in past])
    held = max(abs(spin), abs(across)) < limit + 3.0 * math.sqrt(noise / count)
    held &= max(abs(newest.spin), abs(newest.across)) < 2.0 * limit + 4.0 * math.sqrt(noise)
    return held, noise


def _noise(rates: Sequence[tuple[float, complex]]) -> float:
    """(rad/s)², variance of one axis from successive differences (von Neumann 1941), which no trend is in."""
    pairs = itertools.pairwise(rates)
    squares = sum((spin - before) ** 2 + abs(across - was) ** 2 for (before, was), (spin, across) in pairs)
    return squares / (6.0 * (len(rates) - 1))


def _mean_force(past: list[_Quiet]) -> complex:
    return sum(quiet.force for quiet in past) / len(past)
