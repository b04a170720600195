"""Table rows of calibrated parameters: value and sigma in SI and common units, significance, meaning."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from hubodo.calibration.file import Quantity
from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects import BY_NAME

EffectParameters = Mapping[str, Mapping[str, Quantity]]
PARAMETER_HEADINGS = (
    "effect", "parameter", "value ± 1σ", "unit", "in common units", "significance", "meaning"
)  # fmt: skip
COMMON_UNITS = {
    "rad/s": (math.degrees(3600.0), "°/h"),
    "m/s²": (1e3 / STANDARD_GRAVITY, "mg"),
    "rad": (math.degrees(60.0), "arc-min"),
    "1": (1e6, "ppm"),
    "m": (1e3, "mm"),
}
"""Factor and unit common in data sheets and test reports, by SI unit."""
SIGNIFICANT_SIGMA = 3.0
_MAX_SHOWN_SIGMA = 100.0


def format_with_sigma(value: float, sigma: float) -> str:
    """Return value and sigma, both rounded to the second digit of sigma."""
    if not (math.isfinite(value) and math.isfinite(sigma)) or sigma <= 0.0:
        return f"{value:.4g} ± {sigma:.2g}"
    exponent = math.floor(math.log10(max(abs(value), sigma)))
    digits = 1 - math.floor(math.log10(sigma))
    if -4 <= exponent < 6:
        return f"{value:+z.{max(digits, 0)}f} ± {sigma:.{max(digits, 0)}f}"
    scale, digits = 10.0**exponent, max(digits + exponent, 0)
    return f"({value / scale:+z.{digits}f} ± {sigma / scale:.{digits}f})e{exponent}"


def parameter_rows(effects: EffectParameters) -> Iterator[tuple[str, ...]]:
    """Yield a row of PARAMETER_HEADINGS for each parameter; only an effect's first has the meaning."""
    for name, parameters in effects.items():
        meaning = BY_NAME[name].meaning if name in BY_NAME else ""
        for parameter, quantity in parameters.items():
            unit = BY_NAME[name].unit(parameter) if name in BY_NAME else ""
            ratio = abs(quantity.value) / quantity.sigma if quantity.sigma > 0.0 else math.inf
            shown = f"{ratio:.1f} σ" if ratio < _MAX_SHOWN_SIGMA else f"> {_MAX_SHOWN_SIGMA:.0f} σ"
            value = format_with_sigma(quantity.value, quantity.sigma)
            yield (
                name,
                parameter,
                value,
                "ratio" if unit == "1" else unit,
                _in_common_unit(quantity, unit),
                shown,
                meaning,
            )
            meaning = ""


def _in_common_unit(quantity: Quantity, unit: str) -> str:
    """Return value and sigma in the common unit; "" for a unit that has none."""
    if unit not in COMMON_UNITS:
        return ""
    factor, name = COMMON_UNITS[unit]
    return f"{format_with_sigma(quantity.value * factor, quantity.sigma * factor)} {name}"
