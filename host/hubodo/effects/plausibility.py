"""Plausibility of fitted parameters: magnitudes that a working sensor, mounting or vehicle has."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeVar

from hubodo.effects.base import Effect

_AT_LIMIT = 0.98
"""Share of the plausible magnitude from which on a fitted parameter counts as at its limit."""

AnyEffect = TypeVar("AnyEffect", bound=Effect)


def implausible_parameters(effect: Effect) -> dict[str, float]:
    """Return the fitted parameters at or beyond their plausible magnitude, with that magnitude."""
    bounds = {name: effect.max_plausible(name) for name in effect.fitted_parameters()}
    return {name: bound for name, bound in bounds.items() if abs(getattr(effect, name)) >= _AT_LIMIT * bound}


def limit_to_plausible(effect: AnyEffect) -> AnyEffect:
    """Return the effect with implausible parameters moved to their plausible limit."""
    limits = {
        name: math.copysign(min(bound, abs(getattr(effect, name))), getattr(effect, name))
        for name, bound in implausible_parameters(effect).items()
    }
    return replace(effect, **limits) if limits else effect
