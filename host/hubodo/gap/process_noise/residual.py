"""What a node reads beyond a model, and how large that is: the gap, in units of the noise it declares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.state.noise import ChannelNoise

Masks = Mapping[str, NDArray[np.bool_]]
"""For each node (N,), which of its samples."""


@dataclass(frozen=True)
class Residual:
    """One node at one point of the search; (6, N) where nothing else is said.

    value: measured minus predicted, with what walks at random followed. sensor_sigma: (6, 1), 1 sigma that
    the model file asks for, of the sensors; input_sigma: of the inputs. noise: as the channels show it.
    input_variance: (6,) of what the inputs' noise leaves in a window's mean. effects: what the model gives
    the node.
    """

    node: NodeData
    value: Array
    sensor_sigma: Array
    noise: ChannelNoise
    input_sigma: Array
    input_variance: Array
    effects: Mapping[type[Effect], Effect]

    @property
    def declared(self) -> Array:
        """1 sigma that the model file asks for, of sensors and inputs."""
        return np.asarray(np.hypot(self.sensor_sigma, self.input_sigma))

    def declared_of(self, row: int | np.integer[Any]) -> Array:
        """(N,): the same of one channel."""
        return np.asarray(np.hypot(self.sensor_sigma[row], self.input_sigma[row]))

    @property
    def predicted(self) -> Array:
        """(6, N): what the model reads."""
        return self.node.y - self.value


def gap(residuals: Mapping[str, Residual], inside: Masks | None = None) -> float:
    """Root mean square of residual over declared noise, all channels measured; `inside`: samples."""
    total, count = 0.0, 0
    for name, one in residuals.items():
        at = slice(None) if inside is None else inside[name]
        for row in np.flatnonzero(one.node.used):
            z = one.value[row, at] / one.declared_of(row)[at]
            total, count = total + float(z @ z), count + z.size
    return float(np.sqrt(total / count)) if count else float("nan")


def floor(residuals: Mapping[str, Residual]) -> float:
    """The gap that would be left if nothing but noise were.

    That is the scatter from sample to sample, and that of the inputs as it is declared.
    """
    total, count = 0.0, 0
    for one in residuals.values():
        for row in np.flatnonzero(one.node.used):
            spare = np.hypot(one.noise.of(row), one.input_sigma[row]) / one.declared_of(row)
            total, count = total + float(spare @ spare), count + spare.size
    return float(np.sqrt(total / count)) if count else float("nan")
