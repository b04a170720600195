"""The measurements of a wheel that its mode and the clipping of its window allow."""

from __future__ import annotations

from collections.abc import Sequence

from hubodo.fuse.wheel.measurement_rows import MeasurementRows
from hubodo.fuse.wheel.measurements import BETWEEN_WHEELS, VALID_WHEN_ROLLING, Measurement
from hubodo.fuse.wheel.wheel_mode import WheelMode
from hubodo.fuse.wheel.window import Window


class MeasurementUsage:
    """The rows of the Jacobian that are used in a window."""

    def __init__(self, rows: MeasurementRows) -> None:
        self._rows = rows
        self._by_mode = usage_by_mode(rows.measurements)

    def unused_rows(self, wheel: int, mode: WheelMode, window: Window) -> list[int]:
        """Return the rows of a wheel, by its index, that are not used in this window."""
        return [
            self._rows.row_of(measurement, wheel)
            for measurement, is_used in zip(self._rows.measurements, self._by_mode[mode], strict=True)
            if not is_used or not measurement.is_usable(window)
        ]


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
