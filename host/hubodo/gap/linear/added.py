"""What effects add to a reading: those that leave motion and mounting as they are need no new motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.effects.base import SensorChain

_MOVING = ("true_time", "adjust_geometry", "rotate_into_node", "low_pass_rate")


class Added:
    """What effects add to the readings of one node, all else as it is."""

    def __init__(self, chain: SensorChain, effects: Mapping[type[Effect], Effect]) -> None:
        """chain: what reaches the sensor. effects: what the node has."""
        self._chain = chain
        self._effects = effects
        self._straight = not any(_overrides(kind, "clip_readings") for kind in effects)
        self._present: dict[type[Effect], Array] = {}

    def does(self, kind: type[Effect]) -> bool:
        """Whether an effect of this kind does nothing but add, and nothing comes after that."""
        return self._straight and not any(_overrides(kind, stage) for stage in _MOVING)

    def change(self, there: Effect) -> Array:
        """(6, N): change of the readings when an effect takes the place of the node's own of that kind."""
        kind, own = type(there), self._effects.get(type(there))
        if kind.is_linear:
            return self._added(
                there if own is None else there.with_coordinates(there.coordinates() - own.coordinates())
            )
        if kind not in self._present:
            self._present[kind] = np.zeros((6, 1)) if own is None else self._added(own)
        return self._added(there) - self._present[kind]

    def _added(self, effect: Effect) -> Array:
        both = np.zeros((6, len(self._chain.t)))
        one = replace(self._chain, gyro=both[:3], accel=both[3:])
        effect.add_scale_errors(one)
        effect.add_offsets(one)
        return both


def _overrides(kind: type[Effect], stage: str) -> bool:
    return getattr(kind, stage) is not getattr(Effect, stage)
