"""One wheel of the filter: its columns in the state, its detectors, its angle and its mode."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

from hubodo.arrays import Array
from hubodo.earth import STANDARD_GRAVITY
from hubodo.fuse.wheel.config import WheelNode
from hubodo.fuse.wheel.entries import (
    ACCEL_BIAS_X,
    ACCEL_BIAS_Y,
    CAMBER,
    LEVER_ARM_X,
    LEVER_ARM_Y,
    RATE_BEYOND_RANGE,
    WHEEL_ANGLE,
    Entry,
)
from hubodo.fuse.wheel.gravity_alignment import GravityAlignment, GravityGapCheck
from hubodo.fuse.wheel.measurements import (
    BETWEEN_WHEELS,
    VALID_WHEN_ROLLING,
    LinearisedWindow,
    Measurement,
    WheelGeometry,
)
from hubodo.fuse.wheel.measurements.steady import GRAVITY_SPEED_SIGMA, NodeFixedTerms
from hubodo.fuse.wheel.motion_state import StandstillDetector
from hubodo.fuse.wheel.slip_detector import SlipDetector
from hubodo.fuse.wheel.spin_search import SpinTracker, find_spin
from hubodo.fuse.wheel.thresholds import (
    MAX_MISSING_SHARE,
    SETTLING_WINDOWS,
)
from hubodo.fuse.wheel.wheel_counts import WheelCounts
from hubodo.fuse.wheel.window import EMPTY_WINDOW, WINDOW_S, Window


class WheelMode(Enum):
    """Mode of a wheel in one window: the measurements used; the diagram is in the README of this folder.

    ROLLING: all measurements. DISTRUSTED_SPEED: all but its speed, after the mounting check. SLIPPING: yaw
    and roll rate only. UNKNOWN_ANGLE: its speed only, until gravity has shown the wheel angle. LOST:
    nothing; it slips or its speed is distrusted while the angle is unknown. OUTAGE: nothing; samples are
    missing. DISABLED: nothing for the rest of the drive, after the mounting check.
    """

    ROLLING = "rolling"
    DISTRUSTED_SPEED = "distrusted speed"
    SLIPPING = "slipping"
    UNKNOWN_ANGLE = "unknown angle"
    LOST = "lost"
    OUTAGE = "outage"
    DISABLED = "disabled"

    @property
    def knows_angle(self) -> bool:
        """Return True if the wheel angle is known, so that node axes can be rotated into the vehicle's."""
        return self in (WheelMode.ROLLING, WheelMode.DISTRUSTED_SPEED, WheelMode.SLIPPING)


def select_mode(best: WheelMode, angle_known: bool, is_slipping: bool, missing: float) -> WheelMode:
    """Return the mode of a wheel in a window.

    best: mode that the mounting check allows: ROLLING, DISTRUSTED_SPEED or DISABLED. missing: share of the
    window without samples.
    """
    if best is WheelMode.DISABLED:
        return best
    if missing >= MAX_MISSING_SHARE:
        return WheelMode.OUTAGE
    if not angle_known:
        return WheelMode.UNKNOWN_ANGLE if best is WheelMode.ROLLING and not is_slipping else WheelMode.LOST
    return WheelMode.SLIPPING if is_slipping else best


def usage_by_mode(every: Sequence[Measurement]) -> dict[WheelMode, tuple[bool, ...]]:
    """Return the measurements that each mode of a wheel allows; rolling does not need the wheel angle."""
    nothing = (False,) * len(every)
    return {
        WheelMode.ROLLING: (True,) * len(every),
        WheelMode.DISTRUSTED_SPEED: tuple(it not in BETWEEN_WHEELS for it in every),
        WheelMode.SLIPPING: tuple(it not in VALID_WHEN_ROLLING for it in every),
        WheelMode.UNKNOWN_ANGLE: tuple(it in BETWEEN_WHEELS for it in every),
        WheelMode.LOST: nothing,
        WheelMode.OUTAGE: nothing,
        WheelMode.DISABLED: nothing,
    }


_MIN_IN_RANGE_WINDOWS = SETTLING_WINDOWS
"""Newest windows from which the angle is initialised if their gyro is in range: half a second, in which a
wheel at the range of a usual gyro turns twice. Older windows are then not used."""

MAX_WHEEL_SKEW_WINDOWS = SETTLING_WINDOWS
"""Windows by which an outage of both wheels may begin earlier, or end later, for one of them, as cables and
radios do not fail at once. Estimated."""


@dataclass
class Wheel:
    """One wheel with its node.

    Attributes
    ----------
    columns : state column of each entry of the wheel and of the vehicle.
    view : its present window, evaluated for the measurements.
    best_mode : mode that the mounting check allows.
    is_slipping : True if it slips in the present window, by the slip schedule.
    angle_initialised : True if its wheel angle is known.
    windows_without_angle : windows since the wheel angle was last known.
    misaligned_windows : consecutive windows with gravity elsewhere, see `rate_beyond_range.py`.
    arm_variances : m², of the lever arm before a gyro clipped, see `rate_beyond_range.py`.
    fixed_terms : node-fixed terms of a spin search, to be processed.
    alignment : gravity gathered for the wheel angle.
    counts : for the report.
    """

    name: str
    node: WheelNode
    geometry: WheelGeometry
    standstill: StandstillDetector
    columns: dict[Entry, int]
    view: LinearisedWindow
    spin_tracker: SpinTracker
    slip_detector: SlipDetector = field(default_factory=SlipDetector)
    best_mode: WheelMode = WheelMode.ROLLING
    is_slipping: bool = False
    angle_initialised: bool = False
    windows_without_angle: int = 0
    misaligned_windows: int = 0
    fixed_terms: NodeFixedTerms | None = None
    arm_variances: tuple[float, float] | None = None
    alignment: GravityAlignment = field(default_factory=GravityAlignment)
    counts: WheelCounts = field(default_factory=WheelCounts)
    _gap_check: GravityGapCheck = field(default_factory=GravityGapCheck)
    _late_windows: int = 0

    def mode(self, window: Window) -> WheelMode:
        """Return the mode of the wheel in a window."""
        return select_mode(self.best_mode, self.angle_initialised, self.is_slipping, window.missing)

    def swap_side(self) -> None:
        """Move the wheel to the other side of the vehicle."""
        self.geometry = replace(self.geometry, contact_y=-self.geometry.contact_y)
        self.view = LinearisedWindow(self.geometry, self.columns)

    def gather_gravity(self, window: Window) -> None:
        """Sum gravity, derotated by the spin, until the wheel angle can be initialised from it."""
        if window is EMPTY_WINDOW and self._late_windows > 0:
            # The angle at the end of the outage is known; samples of this wheel arrive a little later than
            # the others.
            self._late_windows -= 1
            self.counts.missing_windows += 1
            return
        self._late_windows = 0
        if window is EMPTY_WINDOW:
            self.mark_missing(1)
            return
        if window.missing > MAX_MISSING_SHARE:
            self.counts.missing_windows += 1
            self._gap_check.start_gap()
            return
        if self.angle_initialised:
            if self._gap_check.has_jumped(window):
                self.counts.angle_losses += 1
                self.drop_angle()
            return
        self.alignment.add(window)

    def mark_missing(self, windows: int) -> None:
        """Count windows without samples that no interpolation bridges; the wheel angle is lost."""
        self.counts.missing_windows += windows
        self.spin_tracker.pause()
        self.drop_angle()

    def resume_angle(self) -> None:
        """Take the wheel angle of the state as known after an outage."""
        self.drop_angle()
        self.angle_initialised = True
        self._late_windows = MAX_WHEEL_SKEW_WINDOWS

    def drop_angle(self) -> None:
        """Discard the wheel angle and start gathering gravity again."""
        self.angle_initialised = False
        self.alignment.clear()
        self._gap_check.clear()

    def _sum_gravity(self, x: list[float], windows: Sequence[Window]) -> complex:
        """Return the derotated force of windows less bias and lever arm, m/s.

        On a fast wheel the centripetal force on an arm of 15 cm is ten times gravity, and does not cancel in
        part of a turn.
        """
        columns = self.columns
        bias = complex(x[columns[ACCEL_BIAS_X]], x[columns[ACCEL_BIAS_Y]])
        arm = complex(x[columns[LEVER_ARM_X]], x[columns[LEVER_ARM_Y]])
        return sum(
            (
                (window.force - bias * window.carrier - arm * window.lever)
                * cmath.exp(1j * window.clock_angle)
                for window in windows
            ),
            0j,
        )

    def initialise_angle(self, x: list[float], p: Array, at_start: bool) -> list[int]:
        """Initialise the wheel angle from gravity, in place, and return the columns that were reset.

        A force e^(-iθ) rotated by e^(ic) points along e^(-i(θ - c)). at_start: the angle at the start of
        gathering, else at its end. No columns if gravity was not found; gathering then starts again.
        """
        columns, gathered = self.columns, self.alignment.take_windows()
        in_range = list(itertools.takewhile(lambda window: window.spin_clipped == 0.0, reversed(gathered)))
        if not at_start and len(in_range) >= _MIN_IN_RANGE_WINDOWS:
            # The spin search assumes a constant change of the rate beyond range, which ends at the range.
            gathered = in_range[::-1]
        if any(window.spin_clipped > 0.0 for window in gathered):
            spin = find_spin(gathered, self.geometry.radius)
            if spin is None:
                self.drop_angle()
                return []
            angle = spin.start_angle if at_start else spin.end_angle
            vertical = self.alignment.count * STANDARD_GRAVITY * WINDOW_S
            x[columns[RATE_BEYOND_RANGE]] = spin.excess if at_start else spin.excess_end
            self.spin_tracker.initialise(x[columns[RATE_BEYOND_RANGE]], 0.0)
            self.fixed_terms = spin.fixed_terms
            reset_state(p, columns[RATE_BEYOND_RANGE], (GRAVITY_SPEED_SIGMA / self.geometry.radius) ** 2)
            reset_columns = [columns[WHEEL_ANGLE], columns[RATE_BEYOND_RANGE]]
        else:
            carrier = self.alignment.start_angle if at_start else self.alignment.end_angle
            gravity = self._sum_gravity(x, gathered)
            angle, vertical = -cmath.phase(gravity) + carrier, abs(gravity)
            reset_columns = [columns[WHEEL_ANGLE]]
        x[columns[WHEEL_ANGLE]] = math.remainder(angle, 2.0 * math.pi)
        # On a fast wheel a tilt causes a far larger axial force than a camber.
        if x[columns[CAMBER]] == 0.0 and self.fixed_terms is None:
            x[columns[CAMBER]] = self.geometry.side * math.atan2(
                sum(window.axial for window in gathered), vertical
            )
        reset_state(p, columns[WHEEL_ANGLE], WHEEL_ANGLE.prior**2)
        self.angle_initialised = True
        return reset_columns


def reset_state(p: Array, column: int, variance: float) -> None:
    """Reset a state's variance and remove its correlations, in place."""
    p[column, :] = 0.0
    p[:, column] = 0.0
    p[column, column] = variance
