"""Table rows of calibrated parameters: value and sigma in SI and common units, significance, meaning."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from hubodo.calibration.file import Quantity
from hubodo.effects import BY_NAME
from hubodo.unit_systems import PARAMETER_UNITS, unit_system

EffectParameters = Mapping[str, Mapping[str, Quantity]]
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


def parameter_headings() -> tuple[str, ...]:
    """Return the headings of `parameter_rows`; a chosen system of units has one column of values."""
    both = ("in common units",) if unit_system() is None else ()
    return ("effect", "parameter", "value ± 1σ", "unit", *both, "significance", "meaning")


def parameter_rows(effects: EffectParameters) -> Iterator[tuple[str, ...]]:
    """Yield a row of `parameter_headings` for each parameter; only an effect's first has the meaning."""
    for name, parameters in effects.items():
        meaning = BY_NAME[name].meaning if name in BY_NAME else ""
        for parameter, quantity in parameters.items():
            unit = BY_NAME[name].unit(parameter) if name in BY_NAME else ""
            ratio = abs(quantity.value) / quantity.sigma if quantity.sigma > 0.0 else math.inf
            shown = f"{ratio:.1f} σ" if ratio < _MAX_SHOWN_SIGMA else f"> {_MAX_SHOWN_SIGMA:.0f} σ"
            yield (name, parameter, *_values(quantity, unit), shown, meaning)
            meaning = ""


def _values(quantity: Quantity, unit: str) -> tuple[str, ...]:
    """Return value with sigma, its unit, and both in the common unit; only one of them if it was chosen."""
    si = format_with_sigma(quantity.value, quantity.sigma), "ratio" if unit == "1" else unit
    common = PARAMETER_UNITS.get(unit)
    if unit_system() == "si" or (common is None and unit_system() is not None):
        return si
    if common is None:
        return (*si, "")
    value = format_with_sigma(quantity.value * common.factor, quantity.sigma * common.factor)
    return (value, common.common) if unit_system() == "common" else (*si, f"{value} {common.common}")
