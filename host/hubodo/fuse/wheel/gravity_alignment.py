"""Gravity gathered until a wheel angle is initialised from it, and the check of its direction after a gap."""

from __future__ import annotations

import cmath
from dataclasses import dataclass, field

from hubodo.fuse.wheel.entries import WHEEL_ANGLE
from hubodo.fuse.wheel.thresholds import BUMP_WINDOWS, GATE_SIGMA, SETTLING_WINDOWS
from hubodo.fuse.wheel.window import Window

MAX_ANGLE_ERROR = GATE_SIGMA * WHEEL_ANGLE.prior
"""rad; a wheel angle is unknown beyond it, as change of the direction of gravity or as sigma: the prior is
the tilt by hard braking."""


@dataclass
class GravityAlignment:
    """The windows gathered for a wheel angle, and the sum of their forces, derotated by the spin.

    Attributes
    ----------
    count : windows since the angle was lost; they are still counted once it is initialised.
    gravity_sum : m/s, sum of the derotated forces.
    start_angle, end_angle : rad, carrier angle at the start and end of the gathering.
    windows : the windows; taken when the angle is initialised.
    """

    count: int = 0
    gravity_sum: complex = 0j
    start_angle: float = 0.0
    end_angle: float = 0.0
    windows: list[Window] = field(default_factory=list)

    def is_ready(self, min_windows: int) -> bool:
        """Return True once at least `min_windows` windows are gathered and contain a force."""
        return self.count >= min_windows and self.gravity_sum != 0j

    def add(self, window: Window) -> None:
        """Gather a window."""
        if self.count == 0:
            self.start_angle = window.clock_angle - 0.5 * window.spin
        self.count += 1
        self.windows.append(window)
        self.gravity_sum += window.force * cmath.exp(1j * window.clock_angle)
        self.end_angle = window.clock_angle + 0.5 * window.spin

    def take_windows(self) -> list[Window]:
        """Return the windows and release them."""
        windows, self.windows = self.windows, []
        return windows

    def clear(self) -> None:
        """Start again."""
        self.count, self.gravity_sum, self.windows = 0, 0j, []


@dataclass
class GravityGapCheck:
    """Comparison of the direction of gravity before and after a gap between samples.

    It changes if the clock jumped, or if the interpolation across the gap missed a turn of the wheel.
    """

    _before: complex = 0j
    _after: complex = 0j
    _n_after: int | None = None

    def start_gap(self) -> None:
        """Begin the comparison after a gap."""
        self._after, self._n_after = 0j, 0

    def clear(self) -> None:
        """Forget the direction."""
        self._before, self._n_after = 0j, None

    def has_jumped(self, window: Window) -> bool:
        """Add a window; return True once gravity points elsewhere than before the gap."""
        if window.spin_clipped > 0.0 or window.force_clipped > 0.0:
            # The carrier does not follow gravity, or the accelerometer clips gravity.
            self.clear()
            return False
        gravity = window.force * cmath.exp(1j * window.clock_angle)
        if self._n_after is None or self._before == 0j:
            self._n_after = None
            # Exponential smoothing.
            weight = 1.0 / SETTLING_WINDOWS
            self._before = (1.0 - weight) * self._before + weight * gravity
            return False
        self._after, self._n_after = self._after + gravity, self._n_after + 1
        if self._n_after < BUMP_WINDOWS:
            return False
        jump = abs(cmath.phase(self._after * self._before.conjugate()))
        self._before, self._n_after = self._after / BUMP_WINDOWS, None
        return jump > MAX_ANGLE_ERROR
