"""Effects that only add to the readings, for which no new motion has to be computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.effects.sensor_chain import SensorChain

_NON_ADDITIVE_STAGES = ("true_time", "adjust_geometry", "rotate_into_node", "low_pass_rate")
_READING_STAGES = (
    "true_time",
    "rotate_into_node",
    "low_pass_rate",
    "add_scale_errors",
    "add_offsets",
    "clip_readings",
)


class AdditiveEffects:
    """Change of one node's readings by effects that only add to them."""

    def __init__(self, chain: SensorChain, effects: Mapping[type[Effect], Effect]) -> None:
        """Prepare for one node; chain: physical input of its sensor; effects: effects of the node."""
        self._chain = chain
        self._effects = effects
        self._straight = not any(_overrides(kind, "clip_readings") for kind in effects)
        self._present: dict[type[Effect], Array] = {}

    def is_additive(self, kind: type[Effect]) -> bool:
        """Return True if effects of a class only add, and no later stage of the sensor chain is nonlinear."""
        return self._straight and not any(_overrides(kind, stage) for stage in _NON_ADDITIVE_STAGES)

    @cached_property
    def gyro_depends_on_force(self) -> bool:
        """Return True if an effect lets the gyro respond to force, so that a force of NaN shows."""
        some = self._chain.select(slice(0, 1))
        probe = replace(some, gyro=some.rate.copy(), accel=some.force.copy(), force=np.full((3, 1), np.nan))
        for effect in self._effects.values():
            effect.add_scale_errors(probe)
            effect.add_offsets(probe)
        return bool(np.isnan(probe.gyro).any())

    def reading_change(self, effect: Effect) -> Array:
        """Return the change of the readings, (6, N), if an effect replaces the node's own of that class."""
        kind, own = type(effect), self._effects.get(type(effect))
        if kind.is_linear:
            return self._added(
                effect if own is None else effect.with_coordinates(effect.coordinates() - own.coordinates())
            )
        if kind not in self._present:
            self._present[kind] = np.zeros((6, 1)) if own is None else self._added(own)
        return self._added(effect) - self._present[kind]

    def _added(self, effect: Effect) -> Array:
        readings = np.zeros((6, len(self._chain.t)))
        output = replace(self._chain, gyro=readings[:3], accel=readings[3:])
        effect.add_scale_errors(output)
        effect.add_offsets(output)
        return readings


def changes_only_geometry(kind: type[Effect]) -> bool:
    """Return True if effects of a class change the geometry and nothing else of a mean reading."""
    return not any(_overrides(kind, stage) for stage in _READING_STAGES)


def _overrides(kind: type[Effect], stage: str) -> bool:
    return getattr(kind, stage) is not getattr(Effect, stage)
