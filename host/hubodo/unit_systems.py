"""Units of tables and pages: SI, those common in data sheets, or each value where it reads best."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from typing import Final

from hubodo.earth import STANDARD_GRAVITY
from hubodo.errors import InputError
from hubodo.spelling import suggest_spelling

UNIT_SYSTEMS: Final = ("common", "si")
UNIT_SYSTEM_ALIASES: Final = {"customary": "common", "SI": "si"}

_DEG: Final = math.degrees(1.0)
_S_PER_H: Final = 3600.0
_chosen: str | None = None


@dataclass(frozen=True)
class ShownUnit:
    """The unit in which values are shown: shown = factor * SI."""

    factor: float
    name: str

    def number(self, value: float, spec: str) -> str:
        """Return an SI value in this unit, formatted by `spec`; in SI units with four digits."""
        sign = "+" if spec.startswith("+") else ""
        return f"{value:{sign}.4g}" if self.factor == 1.0 else f"{value * self.factor:{spec}}"


@dataclass(frozen=True)
class DisplayUnit:
    """An SI unit, the unit common in data sheets and test reports, and common = factor * SI."""

    si: str
    common: str
    factor: float

    def shown(self, default: DisplayUnit | None = None, *, si_by_default: bool = False) -> ShownUnit:
        """Return the chosen unit.

        default: unit whose common name is shown if the user chose none. si_by_default: SI is shown then.
        """
        if _chosen == "si" or (_chosen is None and si_by_default):
            return ShownUnit(1.0, self.si)
        unit = self if _chosen == "common" or default is None else default
        return ShownUnit(unit.factor, unit.common)


RATE: Final = DisplayUnit("rad/s", "°/h", _DEG * _S_PER_H)
"""Biases of gyros, and Earth rate."""
RATE_SAMPLE: Final = DisplayUnit("rad/s", "deg/s", _DEG)
"""Rates of a moving sensor."""
ANGLE_RANDOM_WALK: Final = DisplayUnit("rad/√s", "°/√h", _DEG * math.sqrt(_S_PER_H))
RATE_RANDOM_WALK: Final = DisplayUnit("rad/s/√s", "°/h/√h", _DEG * _S_PER_H * math.sqrt(_S_PER_H))
RATE_RAMP: Final = DisplayUnit("rad/s²", "°/h per hour", _DEG * _S_PER_H**2)
ANGLE: Final = DisplayUnit("rad", "°", _DEG)
SMALL_ANGLE: Final = DisplayUnit("rad", "arc-min", _DEG * 60.0)
ACCELERATION: Final = DisplayUnit("m/s²", "mg", 1e3 / STANDARD_GRAVITY)
GRAVITY: Final = DisplayUnit("m/s²", "g", 1.0 / STANDARD_GRAVITY)
RATIO: Final = DisplayUnit("ratio", "ppm", 1e6)
LENGTH: Final = DisplayUnit("m", "mm", 1e3)
PARAMETER_UNITS: Final = {
    "1": RATIO,
    **{unit.si: unit for unit in (RATE, ACCELERATION, SMALL_ANGLE, LENGTH)},
}
"""Units of a calibrated parameter, by its unit in the calibration file."""


def unit_system() -> str | None:
    """Return `common` or `si` as chosen, or None."""
    return _chosen


def parse_unit_system(text: str) -> str:
    """Return `common` or `si`; raise InputError for another name."""
    system = UNIT_SYSTEM_ALIASES.get(text, text)
    if system not in UNIT_SYSTEMS:
        hint = suggest_spelling(text, UNIT_SYSTEMS)
        raise InputError(f"units {text!r}: choose from {', '.join(UNIT_SYSTEMS)}{hint}")
    return system


def display_units(system: str | None) -> AbstractContextManager[object]:
    """Choose the units of tables, texts and pages; in a `with` statement until its end.

    JSON results, attributes and files are in SI units whatever is chosen.

    Parameters
    ----------
    system : str or None
        `common` for °/h, °/√h, mg, ppm and arc-min, as in data sheets; `si`; None for the choice of each
        table, which often shows both.

    Returns
    -------
    context manager
        Restores the earlier choice at the end of a `with` statement.

    Raises
    ------
    InputError
        If there is no such system.
    """
    before, restore = _chosen, ExitStack()
    _choose(None if system is None else parse_unit_system(system))
    restore.callback(_choose, before)
    return restore


def _choose(system: str | None) -> None:
    """Set the one choice for all results, as numpy has one for the digits that it prints."""
    global _chosen
    _chosen = system


def angle_text(value: float, spec: str) -> str:
    """Return an angle, rad, with its unit."""
    unit = ANGLE.shown()
    return f"{unit.number(value, spec)}{'' if unit.name == ANGLE.common else ' '}{unit.name}"


def without_other_units(rows: Iterable[Sequence[str]], si: int, common: int) -> list[tuple[str, ...]]:
    """Return rows, or headings, without the column of the system that was not chosen.

    si, common: numbers of the columns that hold the same value in each system.
    """
    dropped = {"si": common, "common": si}.get(_chosen or "")
    return [tuple(cell for k, cell in enumerate(row) if k != dropped) for row in rows]
