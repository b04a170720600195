"""Does a wheel roll along with the road? Its own acceleration against the force that its hub feels.

A wheel that slips, or hangs in the air, spins up or down by itself: the accelerometer on it feels what the
vehicle does. Sums of the forward row's residuals over the last windows, up to two seconds of them, are each
held against their variance; the largest tells when it began (generalised likelihood ratio of a jump of
unknown time, Willsky and Jones 1976).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from hubodo.fuse.wheel.window import WINDOW_S

SUM_LENGTHS_WINDOWS = (1, 2, 3, 4, 5, 7, 10, 14, 20, 30, 40, 60)
"""Windows that are summed up; what creeps away for longer than six seconds cannot be told from a slope."""

_SURE = 4.5
"""Sigmas by which a sum must stand out: twelve sums a window, thousands of windows, and none by chance."""

_LEAST = 0.2
"""m/s of slip below which nothing is called one: a bump makes as much for a moment. Estimated."""

_DRIFT = 0.05
"""m/s², 1 sigma of what stays for the windows of a sum beside what the states are unsure of. Estimated."""

_LEANS = 0.1
"""m/s² for each rad/s of yaw rate, 1 sigma: a hundredth of a radian by which an axle leans otherwise than is
believed turns the wheel angle with the yaw, a second long. Estimated."""

_UNEVEN, _GIVES_WAY = 0.15, 2.0
"""m/s², 1 sigma of what an accelerometer across the axle makes up as it turns, twice a turn by scales that
differ (1 % of gravity), once by a bias; s in which the slope gives way to it: on a wheel that turns slower
than that it looks like a slope, and then like none. Estimated."""

_SETTLED, _TURNS, _LONG = 20, 1.0, 300
"""Windows in a row, of a wheel that turns faster than so many rad/s, in which its accelerometer has to agree
with it before it may contradict it; so many windows of rest, and it has to again. Two seconds, half a minute,
through which what is learnt of a noisy node may stray. Estimated."""

_QUIET = 5
"""Windows in which a wheel keeps to the speed that was carried before it is believed again: half a second,
longer than one that spins down takes to pass through that speed. Estimated."""

_AGREES, _NEAR = 3.0, 0.05
"""Sigmas, and m/s beside them, within which it keeps to it."""

_BACK, _JUMP = 0.35, 0.5
"""Shares of its largest slip: a wheel that is back has less than the first, as what was carried may not be
wrong by more; one that touched the road has lost more than the second at once, by itself. Estimated."""

_LINGERS = 30
"""Windows after which one is believed that came near without that, as when the vehicle stopped. Estimated."""

_FOLLOWS = 20.0
"""Logarithm of how much likelier it must be that it follows the vehicle's changes of speed than that it spins
on as it likes, to be believed against the speed that was carried. Estimated; the variances have room."""

_PATIENCE, MAX_SLIP_WINDOWS = 100, 200
"""Quiet windows after which it is believed even so, and windows in any case: ten seconds, through which no
wheel in the air spins on like one on the road; twenty, after which nothing is left of a speed that was
carried. Estimated."""

_BEYOND = 1.5, 0.5
"""Times as fast as the vehicle ever went, and m/s beside that, beyond which a carried speed is not believed
against a wheel that turns slower, nor one that is not known that well against any. Estimated."""


class ForwardResidual(NamedTuple):
    """What the forward row of a window says: residual, m/s, and its variance, (m/s)².

    gain: m/s by which the wheel became faster. common: what the states add to the variance, from window to
    window alike. slope: m/s², as it was taken to be. yaw_rate: rad/s.
    """

    residual: float
    variance: float
    speed_gain: float
    common_variance: float
    slope: float
    yaw_rate: float


class _Sums(NamedTuple):
    """Before a window, in all: residuals, m/s, variances, (m/s)², 1 sigma of what is common, m/s.

    slope: m/s², as the state was.
    """

    number: int
    residual: float
    variance: float
    common: float
    slope: float


@dataclass
class Slip:
    """A time in which a wheel spun by itself.

    first, last: numbers of its windows; last is None while it lasts. speed: m/s, the most by which it turned
    faster than the vehicle moved, negative where slower.
    """

    first: int
    last: int | None = None
    speed: float = 0.0

    @property
    def begin(self) -> float:
        """s on the log's clock."""
        return self.first * WINDOW_S

    @property
    def end(self) -> float:
        """s; infinite while it lasts."""
        return math.inf if self.last is None else (self.last + 1) * WINDOW_S

    @property
    def description(self) -> str:
        """For a user."""
        until = "s and on" if self.last is None else f"to {self.end:.1f} s"
        way = "faster than the road" if self.speed > 0.0 else "slower than the road"
        return (
            f"t = {self.begin:.1f} {until}: the wheel spun by itself, up to {abs(self.speed):.1f} m/s {way}; "
            "slip, or it was in the air; its speed is not used there, sigmas grow"
        )


@dataclass
class SlipDetector:
    """Whether one wheel rolls with the road, and when it did not.

    slips: those found, oldest first. calm: windows in a row by now in which a wheel that is lost agreed with
    its accelerometer. jumped: whether the last slip ended as the wheel lost it by itself, at once.
    """

    slips: list[Slip] = field(default_factory=list)
    consistent_windows: int = 0
    ended_by_jump: bool = True
    _sums: deque[_Sums] = field(default_factory=lambda: deque(maxlen=SUM_LENGTHS_WINDOWS[-1] + 1))
    _total: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _settled: int = 0
    _rested: int = 0
    _near: int = 0
    _follows: float = 0.0
    _jumped: float = 0.0

    @property
    def is_slipping(self) -> bool:
        """Whether it spins by itself now."""
        return bool(self.slips) and self.slips[-1].last is None

    def record_standstill(self) -> None:
        """A window in which the vehicle stands: what shakes it then, or is noise of a gyro, is no slip."""
        self.clear_sums()
        self._rested += 1
        if self._rested >= _LONG:
            self._settled = 0

    def detect_onset(self, number: int, push: ForwardResidual | None, rate: float) -> int | None:
        """A window of a wheel that rolls; the number of the window with which a slip began, if one is found.

        push: None where the window does not tell. rate: rad/s at which it turns.
        """
        self._rested = 0
        if push is None:
            self.clear_sums()
            return None
        if self._settled < _SETTLED:
            if abs(rate) > _TURNS:
                calm = push.residual**2 < _AGREES**2 * push.variance
                self._settled = self._settled + 1 if calm else 0
            return None
        made_up = _UNEVEN / math.hypot(1.0, _GIVES_WAY * rate)
        residual, variance, common = self._total
        self._sums.append(_Sums(number, residual, variance, common, push.slope))
        # As it would be had the slope not given way to it meanwhile.
        residual += push.residual + push.slope * WINDOW_S
        variance += push.variance
        common += math.sqrt(max(push.common_variance, 0.0)) + _LEANS * abs(push.yaw_rate) * WINDOW_S
        self._total = residual, variance, common
        found, most, sums = None, _SURE**2, self._sums
        for count in SUM_LENGTHS_WINDOWS:
            if count > len(sums):
                break
            then = sums[-count]
            span = count * WINDOW_S
            slipped = residual - then.residual - span * then.slope
            # Most sums are nowhere near: nothing further of them needs a look.
            if -_LEAST <= slipped <= _LEAST:
                continue
            stays = (common - then.common) ** 2 + (_DRIFT * span) ** 2 + (made_up * span) ** 2
            ratio = slipped * slipped / (variance - then.variance + stays)
            if ratio > most:
                found, most = then.number, ratio
        return found

    def start_slip(self, number: int) -> None:
        """It spins by itself from that window on."""
        self.slips.append(Slip(number))
        self.clear_sums()
        self._near, self.consistent_windows, self._follows, self._jumped, self.ended_by_jump = (
            0,
            0,
            0.0,
            0.0,
            True,
        )

    def detect_end(
        self,
        number: int,
        push: ForwardResidual | None,
        slip: float,
        variance: float,
        carried: float | None,
        fastest: float,
    ) -> bool:
        """A window of a wheel that spins by itself; whether it has found back to the road.

        slip: m/s by which it turns faster than the vehicle moves; variance: (m/s)² of that. carried: m/s, the
        speed where only accelerometers tell it; None where another wheel does. fastest: m/s, that the vehicle
        went before.
        """
        now = self.slips[-1]
        if number - now.first >= MAX_SLIP_WINDOWS or (
            carried is not None and _absurd(carried, slip, variance, fastest)
        ):
            now.last = number - 1
            self.require_agreement()
            return True
        if abs(slip) > abs(now.speed):
            now.speed = slip
        near = abs(slip) < min(_AGREES * math.sqrt(variance), _BACK * abs(now.speed)) + _NEAR
        if push is None or push.residual**2 > _AGREES**2 * push.variance + (_DRIFT * WINDOW_S) ** 2:
            self.consistent_windows, self._follows = 0, 0.0
            # One that keeps to what another wheel measures has no need to agree with its accelerometer.
            self._near = self._near + 1 if near and carried is None else 0
            if push is not None:
                self._jumped = max(0.0, self._jumped - push.speed_gain * math.copysign(1.0, slip))
            return self._ends(now, number, even=False) if self._near >= _LINGERS else False
        self.consistent_windows += 1
        self._near = self._near + 1 if near else 0
        felt = push.residual + push.speed_gain
        likelier = 0.5 * (felt**2 - push.residual**2) / push.variance
        # However much changes in one window: it may be chance that both do.
        self._follows = max(0.0, self._follows + min(likelier, _FOLLOWS / _QUIET))
        # Against what another wheel measures it helps nothing to spin evenly.
        even = carried is not None and (self._follows >= _FOLLOWS or self.consistent_windows >= _PATIENCE)
        return self._ends(now, number, even)

    def _ends(self, now: Slip, number: int, even: bool) -> bool:
        """Whether it has been near for long enough, or spun evenly."""
        jumped = self._jumped > _JUMP * abs(now.speed)
        if self._near < (_QUIET if jumped else _LINGERS) and not even:
            return False
        self.ended_by_jump = jumped
        now.last = number - max(self._near, 1)
        return True

    def end_by_outage(self, number: int) -> None:
        """Up to that window nothing was heard: it begins anew as a wheel that rolls."""
        if self.is_slipping:
            self.slips[-1].last = number
        self.require_agreement()

    def require_agreement(self) -> None:
        """Its accelerometer has to agree with it again before it may contradict it."""
        self._settled = 0
        self.clear_sums()

    def clear_sums(self) -> None:
        """What was summed up."""
        self._sums.clear()
        self._total = (0.0, 0.0, 0.0)


def _absurd(carried: float, slip: float, variance: float, fastest: float) -> bool:
    """Whether a speed that was carried is worth less than a wheel that may slip."""
    limit = _BEYOND[0] * fastest + _BEYOND[1]
    return abs(carried) > limit > abs(carried + slip) or variance > limit * limit
