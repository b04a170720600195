"""A window: what one node measured in a tenth of a second, as integrals that no estimate enters."""

from __future__ import annotations

from typing import NamedTuple

from hubodo.fuse.wheel.window_samples import WindowSamples

WINDOW = 0.1
"""Length of a window, s.

At 2000 deg/s half a turn, and an error of 1 % in spin turns its ends by 2 mrad/(rad/s).
"""

_ALL = 1.0 - 1e-9
"""Share of a window that is all of it, but for rounding."""


class Window(NamedTuple):
    """Integrals over one window, of a node turned so that it faces left.

    number: of the window; it lies between start + number * WINDOW and one WINDOW later. The carrier c(t) is
    the integral of the measured gz since the middle of the window (in angle); complex numbers are x + iy of
    the node. spin: int gz. rate_start, rate_end: gz at the edges. across: int (gx + i gy) e^(ic). carrier:
    int e^(ic). force: int (ax + i ay) e^(ic). axial: int az. raw_force: int (ax + i ay). raw_across: int
    (gx + i gy). gyro_variance, axial_variance: within the window, (rad/s)² of all three axes and (m/s²)² of
    az. spin_clipped, across_clipped, force_clipped, axial_clipped: share of the time in which gz, gx or gy,
    ax or ay, az stood at its limit. missing: share of the time without samples. clock_angle: the carrier's
    angle at the middle since the first sample. swing: int gz e^(ic), which is real; lever: i gz e^(ic) at the
    end less that at the start; across_change: the same of (gx + i gy) e^(ic). samples: where gz was clipped.
    """

    number: int = 0
    spin: float = 0.0
    rate_start: float = 0.0
    rate_end: float = 0.0
    across: complex = 0j
    carrier: complex = 0j
    force: complex = 0j
    axial: float = 0.0
    raw_across: complex = 0j
    raw_force: complex = 0j
    gyro_variance: float = 0.0
    axial_variance: float = 0.0
    spin_clipped: float = 0.0
    across_clipped: float = 0.0
    force_clipped: float = 0.0
    axial_clipped: float = 0.0
    missing: float = 0.0
    clock_angle: float = 0.0
    swing: complex = 0.0
    lever: complex = 0j
    across_change: complex = 0j
    samples: WindowSamples | None = None

    @property
    def all_clipped(self) -> bool:
        """Whether gz stood at its limit all the time: then its scale and bias do not show either."""
        return self.spin_clipped > _ALL


NOTHING = Window(missing=1.0)
"""A window in which the node was not heard, and that no straight line bridges."""
