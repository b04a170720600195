"""Remarks on the forecast of a warm-up: a stated form, hysteresis, and misses of the record's own end."""

from __future__ import annotations

from hubodo.sensors.warmup.forecast import StatedForm
from hubodo.sensors.warmup.hysteresis import Hysteresis

NOTED_INFLATION = 2.0
"""Factor of the sigmas from which a remark is made, and a stated form is doubted."""


def forecast_remarks(
    form: StatedForm | None, hysteresis: Hysteresis | None, inflation: float
) -> tuple[str, ...]:
    """Return the remarks on a forecast whose sigmas are `inflation` times those of the forms."""
    remarks = []
    if form is not None:
        remarks.append(
            f"the form is stated: the sigmas of the forecast are those of {form}, with the slow noise that "
            "the record shows"
        )
    if hysteresis is not None:
        remarks.append(hysteresis.describe())
    if inflation >= NOTED_INFLATION:
        remarks.append(
            "a forecast from the first part of the record missed the rest by "
            f"{inflation:.1f} sigma (rms): something else than a warm-up moves the bias, such as the "
            f"temperature of the room, and the sigmas of the forecast are {inflation:.1f} times as large"
        )
    return tuple(remarks)
