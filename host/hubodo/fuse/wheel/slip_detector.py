"""Slip detection for one wheel: its own acceleration against the specific force at its hub.

A wheel that slips, or hangs in the air, changes its speed independently of the vehicle, whose acceleration
its accelerometer measures. The residual of the forward measurement is summed over windows of several lengths,
up to six seconds; each sum is compared with its variance, and the most significant one tells when the slip
began (generalised likelihood ratio test of a jump at unknown time, Willsky and Jones 1976).
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from hubodo.fuse.wheel.free_motion import vehicle_motion_sigmas
from hubodo.fuse.wheel.thresholds import (
    GATE_SIGMA,
    MANOEUVRE_S,
    MANOEUVRE_WINDOWS,
    MAX_UNCONFIRMED_WINDOWS,
    MIN_ROLLING_RATE,
    SETTLING_WINDOWS,
)
from hubodo.fuse.wheel.window import WINDOW_S

SUM_LENGTHS_WINDOWS = (1, 2, 3, 4, 5, 7, 10, 14, 20, 30, 40, 60)
"""Windows per sum. What grows for longer than six seconds is indistinguishable from a slope."""

_SUM_SPANS = tuple((length, length * WINDOW_S) for length in SUM_LENGTHS_WINDOWS)
"""Windows and duration, s, of each sum."""

_SLIP_SIGMA = 4.5
"""Significance of a slip: with twelve sums per window and thousands of windows no false alarm is expected."""

_MIN_SLIP_SPEED = 0.2
"""m/s of slip; a pothole produces as much for one window. Estimated."""

_RESIDUAL_DRIFT = 0.05
"""m/s², 1 sigma of a constant residual during a sum, beside the uncertainty of the states. Estimated."""

_ACCEL_RIPPLE = 0.15
"""m/s², 1 sigma of the ripple of an accelerometer across the axle, twice a turn by unequal scales (1 % of
gravity) and once by a bias. The slope state follows it on a wheel that hardly turns in `MANOEUVRE_S`: it then
looks like a slope that ends. Per rad/s of yaw rate, also of 0.015 rad of axle lean, not modelled, which
rotates the wheel angle with the yaw for a second. Estimated."""

_AGREEMENT_WINDOWS = MANOEUVRE_WINDOWS
"""Consecutive windows, of a wheel faster than `MIN_ROLLING_RATE`, in which the accelerometer must agree with
the wheel before it may contradict it."""

_NEAR_WINDOWS = SETTLING_WINDOWS
"""Windows near the vehicle speed after which a slip ends that lost speed in a jump: longer than a wheel that
spins down takes to pass through that speed. Estimated."""

_SLOW_END_WINDOWS = MANOEUVRE_WINDOWS
"""Windows near the vehicle speed after which a slip without a jump ends, as when the vehicle stops."""

_SLIP_SHARE = 0.5
"""Share of the largest slip: a wheel that rolls again is nearer to the vehicle speed, as an inertial speed is
hardly wrong by more; one that touched the road lost more at once. Estimated."""

_MAX_CONSISTENT_WINDOWS = 100
"""Windows of agreement with the accelerometer after which a slip ends against an inertial speed (10 s: no
wheel in the air spins so steadily). Estimated."""


class ForwardResidual(NamedTuple):
    """Residual of the forward measurement of one window.

    Attributes
    ----------
    residual, variance : m/s and (m/s)².
    speed_gain : m/s by which the wheel became faster.
    common_variance : (m/s)², contribution of the states, fully correlated between windows.
    slope : m/s², estimated slope force.
    yaw_rate : rad/s.
    """

    residual: float
    variance: float
    speed_gain: float
    common_variance: float
    slope: float
    yaw_rate: float


class _RunningSums(NamedTuple):
    """Sums before a window: residuals, m/s; variances, (m/s)²; correlated sigmas, m/s. slope: m/s²."""

    number: int
    residual: float
    variance: float
    common_sigma: float
    slope: float


@dataclass
class Slip:
    """A slip of one wheel.

    first, last: numbers of its windows; last is None while it lasts. speed: m/s, largest slip, negative where
    the wheel is slower than the vehicle.
    """

    first: int
    last: int | None = None
    speed: float = 0.0

    @property
    def start(self) -> float:
        """Return its start, s on the log's clock."""
        return self.first * WINDOW_S

    @property
    def end(self) -> float:
        """Return its end, s; infinite while it lasts."""
        return math.inf if self.last is None else (self.last + 1) * WINDOW_S

    @property
    def description(self) -> str:
        """Return a sentence for the user."""
        until = "s and on" if self.last is None else f"to {self.end:.1f} s"
        comparison = "faster than the road" if self.speed > 0.0 else "slower than the road"
        return (
            f"t = {self.start:.1f} {until}: the wheel slipped or was in the air, up to {abs(self.speed):.1f} "
            f"m/s {comparison}; its speed is not used there, sigmas grow"
        )


@dataclass
class SlipDetector:
    """Detector of start and end of the slips of one wheel.

    slips: oldest first. consistent_windows: consecutive windows of a slipping wheel that agreed with its
    accelerometer. ended_by_jump: True if the last slip ended by a sudden loss of the slip speed.
    """

    slips: list[Slip] = field(default_factory=list)
    consistent_windows: int = 0
    ended_by_jump: bool = True
    _sums: deque[_RunningSums] = field(default_factory=lambda: deque(maxlen=SUM_LENGTHS_WINDOWS[-1] + 1))
    _totals: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _agreeing_windows: int = 0
    _standstill_windows: int = 0
    _near_windows: int = 0
    _following_ratio: float = 0.0
    _lost_speed: float = 0.0

    @property
    def is_slipping(self) -> bool:
        """Return True while a slip lasts."""
        return bool(self.slips) and self.slips[-1].last is None

    def record_standstill(self) -> None:
        """Process a window at standstill, in which vibration and gyro noise do not count as slip."""
        self.clear_sums()
        self._standstill_windows += 1
        # Learnt parameters of a noisy node drift meanwhile.
        if self._standstill_windows >= MAX_UNCONFIRMED_WINDOWS:
            self._agreeing_windows = 0

    def detect_onset(self, number: int, forward: ForwardResidual | None, rate: float) -> int | None:
        """Process a window of a rolling wheel and return the window in which a slip began, if any.

        forward: None if the window does not measure it. rate: rad/s, rolling rate.
        """
        self._standstill_windows = 0
        if forward is None:
            self.clear_sums()
            return None
        if self._agreeing_windows < _AGREEMENT_WINDOWS:
            if abs(rate) > MIN_ROLLING_RATE:
                agrees = forward.residual**2 < GATE_SIGMA**2 * forward.variance
                self._agreeing_windows = self._agreeing_windows + 1 if agrees else 0
            return None
        ripple = _ACCEL_RIPPLE / math.hypot(1.0, MANOEUVRE_S * rate)
        residual, variance, common_sigma = self._totals
        self._sums.append(_RunningSums(number, residual, variance, common_sigma, forward.slope))
        # Undo the adaptation of the slope state to the slip.
        residual += forward.residual + forward.slope * WINDOW_S
        variance += forward.variance
        common_sigma += math.sqrt(max(forward.common_variance, 0.0))
        common_sigma += _ACCEL_RIPPLE * abs(forward.yaw_rate) * WINDOW_S
        self._totals = residual, variance, common_sigma
        onset, largest, sums = None, _SLIP_SIGMA**2, self._sums
        for length, span in _SUM_SPANS[: bisect_right(SUM_LENGTHS_WINDOWS, len(sums))]:
            first, start_residual, start_variance, start_common_sigma, start_slope = sums[-length]
            slip = residual - start_residual - span * start_slope
            # Early exit: most sums are far below the threshold.
            if -_MIN_SLIP_SPEED <= slip <= _MIN_SLIP_SPEED:
                continue
            correlated = (
                (common_sigma - start_common_sigma) ** 2
                + (_RESIDUAL_DRIFT * span) ** 2
                + (ripple * span) ** 2
            )
            ratio = slip * slip / (variance - start_variance + correlated)
            if ratio > largest:
                onset, largest = first, ratio
        return onset

    def start_slip(self, number: int) -> None:
        """Start a slip with window `number`."""
        self.slips.append(Slip(number))
        self.clear_sums()
        self._near_windows, self.consistent_windows = 0, 0
        self._following_ratio, self._lost_speed, self.ended_by_jump = 0.0, 0.0, True

    def detect_end(
        self,
        number: int,
        forward: ForwardResidual | None,
        slip: float,
        variance: float,
        inertial_speed: float | None,
        max_speed: float,
    ) -> bool:
        """Process a window of a slipping wheel; return True if it rolls again.

        slip: m/s by which the wheel is faster than the vehicle; variance: its variance, (m/s)².
        inertial_speed: m/s if only accelerometers measure the speed; None if another wheel does. max_speed:
        m/s reached before.
        """
        current = self.slips[-1]
        if number - current.first >= MAX_UNCONFIRMED_WINDOWS or (
            inertial_speed is not None and _is_implausible(inertial_speed, slip, variance, max_speed)
        ):
            current.last = number - 1
            self.require_agreement()
            return True
        if abs(slip) > abs(current.speed):
            current.speed = slip
        is_near = abs(slip) <= min(GATE_SIGMA * math.sqrt(variance), _SLIP_SHARE * abs(current.speed))
        if (
            forward is None
            or forward.residual**2 > GATE_SIGMA**2 * forward.variance + (_RESIDUAL_DRIFT * WINDOW_S) ** 2
        ):
            self.consistent_windows, self._following_ratio = 0, 0.0
            # A wheel whose speed agrees with that of another wheel need not agree with its accelerometer.
            self._near_windows = self._near_windows + 1 if is_near and inertial_speed is None else 0
            if forward is not None:
                self._lost_speed = max(0.0, self._lost_speed - forward.speed_gain * math.copysign(1.0, slip))
            return self._near_windows >= _SLOW_END_WINDOWS and self._end_slip(
                current, number, is_consistent=False
            )
        self.consistent_windows += 1
        self._near_windows = self._near_windows + 1 if is_near else 0
        measured_gain = forward.residual + forward.speed_gain
        # Twice the log likelihood ratio of "follows the vehicle" and "spins freely": a wheel is trusted
        # against an inertial speed if it is as significant as a slip.
        following = (measured_gain**2 - forward.residual**2) / forward.variance
        # One window alone never decides: both changes may coincide by chance.
        self._following_ratio = max(
            0.0, self._following_ratio + min(following, _SLIP_SIGMA**2 / _NEAR_WINDOWS)
        )
        # If another wheel measures the speed, agreement with the accelerometer alone does not end a slip.
        is_consistent = inertial_speed is not None and (
            self._following_ratio >= _SLIP_SIGMA**2 or self.consistent_windows >= _MAX_CONSISTENT_WINDOWS
        )
        return self._end_slip(current, number, is_consistent)

    def _end_slip(self, current: Slip, number: int, is_consistent: bool) -> bool:
        """End the slip if it was small for long enough, or the wheel is consistent; return True if so."""
        jumped = self._lost_speed > _SLIP_SHARE * abs(current.speed)
        if self._near_windows < (_NEAR_WINDOWS if jumped else _SLOW_END_WINDOWS) and not is_consistent:
            return False
        self.ended_by_jump = jumped
        current.last = number - max(self._near_windows, 1)
        return True

    def end_by_outage(self, number: int) -> None:
        """End a slip with an outage up to that window."""
        if self.is_slipping:
            self.slips[-1].last = number
        self.require_agreement()

    def require_agreement(self) -> None:
        """Require that the accelerometer agrees with the wheel before it may contradict it again."""
        self._agreeing_windows = 0
        self.clear_sums()

    def clear_sums(self) -> None:
        """Discard the sums."""
        self._sums.clear()
        self._totals = (0.0, 0.0, 0.0)


def _is_implausible(inertial_speed: float, slip: float, variance: float, max_speed: float) -> bool:
    """Return True if an inertial speed is less plausible than the speed of a wheel that may slip."""
    limit = vehicle_motion_sigmas(max_speed).speed
    return abs(inertial_speed) > limit > abs(inertial_speed + slip) or variance > limit * limit
