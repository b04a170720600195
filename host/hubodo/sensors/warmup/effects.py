"""A fitted warm-up model as effects of the calibration file."""

from __future__ import annotations

from collections.abc import Mapping

from hubodo.calibration.file import CalibratedEffect, Quantity
from hubodo.effects.temperature import POLYNOMIAL_SUFFIXES
from hubodo.effects.warmup import TEMPERATURE_PARAMETERS
from hubodo.sensors.warmup.fit import WarmupFit


def effects_of_fit(fit: WarmupFit, sigma: Mapping[str, float], axis: str) -> dict[str, CalibratedEffect]:
    """Return the bias, warm-up and temperature effects of one axis by name; sigma: by parameter."""

    def quantity(name: str) -> Quantity:
        return Quantity(fit.values[name], sigma[name])

    method = f"warm-up at rest, {fit.kind}"
    effects = {"gyro_bias": CalibratedEffect({axis: quantity("c2")}, method)}
    warmup = {}
    for suffix in ("", "_second"):
        if f"c1{suffix}" in fit.values:
            warmup[axis + suffix] = quantity(f"c1{suffix}")
            warmup[f"time_constant{suffix}"] = quantity(f"time_constant{suffix}")
    if warmup:
        effects["gyro_warmup"] = CalibratedEffect(warmup, method)
    if fit.temperature_order:
        pairs = zip(POLYNOMIAL_SUFFIXES, TEMPERATURE_PARAMETERS[: fit.temperature_order], strict=False)
        polynomial = {axis + suffix: quantity(name) for suffix, name in pairs}
        effects["gyro_temperature"] = CalibratedEffect(polynomial, method)
    return effects
