"""Does a wheel stand still? Judged by what changes, so that an unknown bias does not hide a rest."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import IntEnum

from hubodo.fuse.wheel.preintegration import WINDOW, Window

_SPAN = 10
"""Windows that are looked at, one second: longer than a wheel pauses when its direction is changed."""


class Stillness(IntEnum):
    """MOVING; ROCKING: rocking about one place, as with hands on the rims; RESTING: nothing moves."""

    MOVING = 0
    ROCKING = 1
    RESTING = 2


@dataclass(frozen=True, slots=True)
class RestLimits:
    """Where stillness ends; all estimated: between what idle hands and engines do and the slowest drive.

    rate_spread: rad/s of the gyro within a window, its own noise included. turning: m/s² by which the mean
    specific force may change over a second. rate: rad/s by which the mean rates may differ from their
    biases, beside three sigma of these. Those of rocking are `rocking_spread`, `rocking_turning`,
    `rocking_rate`."""

    rate_spread: float = 0.02
    turning: float = 0.06
    rate: float = 0.01
    rocking_spread: float = 0.25
    rocking_turning: float = 0.8
    rocking_rate: float = 0.12


@dataclass
class RestDetector:
    """A second without vibration, without turning of gravity and with no rate beyond what bias explains.

    A steadily rolling wheel turns gravity; a wheel on the spot of which the vehicle pivots does not, but it
    shows a rate across the axle: that is told from a bias as far as the bias is known.
    """

    limits: RestLimits = field(default_factory=RestLimits)
    _quiet: deque[complex] = field(default_factory=lambda: deque(maxlen=_SPAN))
    _near: deque[complex] = field(default_factory=lambda: deque(maxlen=_SPAN))

    def stillness(self, window: Window, spin_bias: float, across_bias: complex, sigma: float) -> Stillness:
        """How still the wheel has been up to the end of this window.

        spin_bias: rad/s of gz; across_bias: of gx + i gy; sigma: 1 sigma of the least known of them.
        """
        limits, margin = self.limits, 3.0 * sigma
        if window.missing > 0.0:
            self._quiet.clear()
            self._near.clear()
            return Stillness.MOVING
        rate = abs(window.spin / WINDOW - spin_bias)
        if rate >= limits.rocking_rate + margin:
            # Most windows of a drive: nothing further needs a look.
            self._quiet.clear()
            self._near.clear()
            return Stillness.MOVING
        rate = max(rate, abs(window.raw_across / WINDOW - across_bias))
        force = window.raw_force / WINDOW
        still = window.gyro_variance < limits.rate_spread**2 and rate < limits.rate + margin
        near = window.gyro_variance < limits.rocking_spread**2 and rate < limits.rocking_rate + margin
        if _held(self._quiet, still, force, limits.turning):
            self._near.append(force)
            return Stillness.RESTING
        return (
            Stillness.ROCKING if _held(self._near, near, force, limits.rocking_turning) else Stillness.MOVING
        )


def _held(past: deque[complex], passes: bool, force: complex, turning: float) -> bool:
    if not passes:
        past.clear()
        return False
    past.append(force)
    return len(past) == past.maxlen and all(abs(force - old) < turning for old in past)
