"""A speed that gyros on wheels measured: how wrong it is for the errors that a model gives those."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.effects.base import SensorChain
from hubodo.gap.problem.problem import NodeData
from hubodo.model.forward import NodeInitialState
from hubodo.vehicle import facing_sign


@dataclass(frozen=True)
class SpeedError:
    """Of one gyro: (N,) m/s to be added to what it measured, and the same per rad/s that it reads more."""

    value: Array
    per_rate: Array


def speed_error(node: NodeData, effects: Mapping[type[Effect], Effect], alone: bool) -> SpeedError:
    """The input took nominal radius times what the z gyro reads for the speed.

    alone: no gyro on another wheel measured it, too.
    """
    there = [effect for effect in effects.values() if effect.visible_in == "mean"]
    reading = node.forward.mean_reading(there, NodeInitialState())
    rolling, body = reading.rolling, reading.body
    assert rolling is not None
    nominal, side = node.forward.wheel_radius, 1.0 if node.mount.side == "left" else -1.0
    facing = facing_sign(node.mount.facing or "left")
    y = 0.5 * side * node.forward.track_width
    beside = facing * reading.gyro[2] - rolling.spin
    contact = body.speed - body.yaw_rate * y
    turning = np.abs(rolling.spin) > 1e-2
    radius = np.where(turning, contact / np.where(turning, rolling.spin, 1.0), nominal)
    wrong = (radius / nominal - 1.0) * contact - radius * beside
    return SpeedError(wrong + body.yaw_rate * y if alone else wrong, -facing * radius)


def measuring_chain(node: NodeData, effects: Mapping[type[Effect], Effect]) -> SensorChain:
    """What reaches the sensor of a node that measures the speed, the motion as it was measured."""
    there = [effect for effect in effects.values() if effect.visible_in == "mean"]
    return node.forward.true_signals(there, NodeInitialState())[0]


def joined(sources: Sequence[NodeData], errors: Mapping[str, Array]) -> Array:
    """(N,) m/s: the mean of the gyros' errors, at the stamps of the first. errors: none for those without."""
    first = sources[0]
    total = np.zeros(len(first.t))
    for node in sources:
        if node.name in errors:
            total += errors[node.name] if node is first else np.interp(first.t, node.t, errors[node.name])
    return total / len(sources)
