"""Residuals of a node and the gap: their size in units of the declared noise."""

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

SampleMasks = Mapping[str, NDArray[np.bool_]]
"""Mask of the samples, (N,), by node."""


@dataclass(frozen=True)
class WalkSteps:
    """Steps of the random walks that were removed from a residual, which are residuals of the walks.

    steps: (W, M), from window to window, in sigma of the walk's intensity
    samples: (M,) sample of the node at each step
    """

    steps: Array
    samples: NDArray[np.intp]


NO_STEPS = WalkSteps(np.zeros((0, 0)), np.zeros(0, np.intp))


@dataclass(frozen=True)
class Residual:
    """Residual of one node in one evaluation; arrays are (6, N) unless stated.

    value: measured minus predicted, with random walks removed
    sensor_sigma: (6, 1), declared 1 sigma of the sensors
    noise: estimated noise of the channels
    input_sigma: declared 1 sigma due to the inputs
    input_variance: (6,) variance of a window's mean due to noise of the inputs
    effects: effects of the node
    walk_steps: steps of the node's random walks
    """

    node: NodeData
    value: Array
    sensor_sigma: Array
    noise: ChannelNoise
    input_sigma: Array
    input_variance: Array
    effects: Mapping[type[Effect], Effect]
    walk_steps: WalkSteps = NO_STEPS

    @property
    def declared_sigma(self) -> Array:
        """Return the declared 1 sigma of sensors and inputs together, (6, N)."""
        return np.asarray(np.hypot(self.sensor_sigma, self.input_sigma))

    def declared_channel_sigma(self, row: int | np.integer[Any]) -> Array:
        """Return the declared 1 sigma of one channel, (N,)."""
        return np.asarray(np.hypot(self.sensor_sigma[row], self.input_sigma[row]))

    @property
    def predicted(self) -> Array:
        """Return the predicted readings, (6, N)."""
        return self.node.y - self.value


def compute_gap(residuals: Mapping[str, Residual], masks: SampleMasks | None = None) -> float:
    """Return the rms of residual over declared noise, over all channels and the samples of `masks`.

    Steps of the random walks count as residuals of the walks: a walk that follows a misfit does not hide it.
    """
    total, count = 0.0, 0
    for name, residual in residuals.items():
        selected = slice(None) if masks is None else masks[name]
        for row in np.flatnonzero(residual.node.used):
            z = residual.value[row, selected] / residual.declared_channel_sigma(row)[selected]
            total, count = total + float(z @ z), count + z.size
        walk = residual.walk_steps
        steps = walk.steps if masks is None else walk.steps[:, masks[name][walk.samples]]
        total, count = total + float(np.vdot(steps, steps)), count + steps.size
    return float(np.sqrt(total / count)) if count else float("nan")


def compute_gap_floor(residuals: Mapping[str, Residual]) -> float:
    """Return the gap of noise alone: sample-to-sample scatter and declared noise of the inputs."""
    total, count = 0.0, 0
    for residual in residuals.values():
        for row in np.flatnonzero(residual.node.used):
            ratio = np.hypot(
                residual.noise.channel_sigma(row), residual.input_sigma[row]
            ) / residual.declared_channel_sigma(row)
            total, count = total + float(ratio @ ratio), count + ratio.size
        n_steps = residual.walk_steps.steps.size
        total, count = total + n_steps, count + n_steps
    return float(np.sqrt(total / count)) if count else float("nan")
