"""The result of comparing two logs of one vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from hubodo.effects import BY_NAME
from hubodo.gap.explain.result import Estimate
from hubodo.model.model_file import Model

# P-value below which a change is reported.
CHANGE_P_VALUE = 0.01


@dataclass(frozen=True)
class Change:
    """An effect with another value in the second log.

    values: for each parameter its value before, its value after, and the difference
    p_value: probability that the best of all candidates differs as much if nothing has changed
    where: channels, times and regimes that show it, in words
    """

    effect: str
    scope: str
    values: dict[str, tuple[Estimate, Estimate, Estimate]]
    p_value: float
    where: str

    @property
    def belongs_to_drive(self) -> bool:
        """Return True for an offset, a clock or the road: it differs between drives of one vehicle."""
        return BY_NAME[self.effect].varies_between_drives

    def as_json(self) -> dict[str, Any]:
        """Return the entry of `changes` in `change.json`."""
        keys = ("before", "after", "change")
        return {
            "effect": self.effect,
            "scope": self.scope,
            "parameters": {
                name: {
                    key: {"value": _finite(estimate.value), "sigma": _finite(estimate.sigma)}
                    for key, estimate in zip(keys, three, strict=True)
                }
                | {"unit": three[0].unit}
                for name, three in self.values.items()
            },
            "of_this_drive": self.belongs_to_drive,
            "p_value": self.p_value,
            "where": self.where,
        }


@dataclass(frozen=True)
class ChangeResult:
    """Result of comparing two logs.

    p_value: probability that two logs differ as much if nothing has changed
    changes: in order of discovery
    unnamed_terms: terms without a name that only the second log requires
    model_before, model_after: the vehicle in the first and in the second log
    is_correlated: True if residuals are so correlated, as on real roads, that the p-value is not reliable
    """

    p_value: float
    changes: tuple[Change, ...]
    unnamed_terms: tuple[str, ...]
    model_before: Model
    model_after: Model
    warnings: tuple[str, ...]
    is_correlated: bool = False

    @property
    def vehicle_changes(self) -> tuple[Change, ...]:
        """Return the changes of the vehicle, without offsets, clocks and the road."""
        return tuple(change for change in self.changes if not change.belongs_to_drive)

    @property
    def has_changed(self) -> bool:
        """Return True if the vehicle has changed, or no known effect explains the difference of the logs."""
        is_unexplained = not self.changes and not self.is_correlated and self.p_value < CHANGE_P_VALUE
        return is_unexplained or bool(self.vehicle_changes)

    def as_json(self) -> dict[str, Any]:
        """Return the content of `change.json`."""
        return {
            "changed": self.has_changed,
            "p_value": self.p_value,
            "changes": [change.as_json() for change in self.changes],
            "unnamed": list(self.unnamed_terms),
            "correlated": self.is_correlated,
            "warnings": list(self.warnings),
        }


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value


def subtract_estimates(before: Estimate, after: Estimate) -> Estimate:
    """Return the difference of two independent estimates; an unknown sigma counts as zero if one is known."""
    sigmas = [one.sigma for one in (before, after) if one.sigma is not None]
    return Estimate(after.value - before.value, math.hypot(*sigmas) if sigmas else None, after.unit)
