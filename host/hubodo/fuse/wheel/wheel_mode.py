"""Mode of a wheel in a window, and the measurements that each mode allows."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from hubodo.fuse.wheel.measurements import BETWEEN_WHEELS, VALID_WHEN_ROLLING, Measurement
from hubodo.fuse.wheel.thresholds import MAX_MISSING_SHARE


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
