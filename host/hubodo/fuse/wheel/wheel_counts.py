"""Counts of one wheel for the report of a drive."""

from __future__ import annotations

import cmath
from dataclasses import dataclass

from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.thresholds import MAX_UNCONFIRMED_WINDOWS, MIN_ROLLING_RATE
from hubodo.fuse.wheel.window import WINDOW_S, Window


@dataclass
class WheelCounts:
    """Counts of the windows of one wheel, and sums over them.

    Attributes
    ----------
    turned_angle, net_angle : rad by which the wheel turned: sum of magnitudes, and net.
    upright_sum, upright_count : sum over windows of the force that points up, in units of g, and their
        number.
    outlier_windows, clipped_windows, missing_windows, angle_losses : counts.
    blind_windows : count of windows in which the gyro about the axle is saturated and the accelerometers
        across it are, too, so that no axis shows gravity.
    """

    turned_angle: float = 0.0
    net_angle: float = 0.0
    upright_sum: float = 0.0
    upright_count: int = 0
    outlier_windows: int = 0
    clipped_windows: int = 0
    blind_windows: int = 0
    missing_windows: int = 0
    angle_losses: int = 0

    def add_window(self, window: Window, rate: float, angle: float | None) -> None:
        """Count a window; rate: rad/s, rolling; angle: rad, of the wheel at its start, None if unknown."""
        self.turned_angle += abs(rate) * WINDOW_S
        self.net_angle += rate * WINDOW_S
        self.clipped_windows += window.spin_clipped > 0.0
        self.blind_windows += window.blind_windows > 0
        if (
            angle is not None
            and self.upright_count < MAX_UNCONFIRMED_WINDOWS
            and abs(rate) > MIN_ROLLING_RATE
            and window.force_clipped == 0.0
        ):
            rotation = cmath.exp(1j * (angle + 0.5 * rate * WINDOW_S))
            self.upright_sum += (window.force * rotation).real / (STANDARD_GRAVITY * WINDOW_S)
            self.upright_count += 1
