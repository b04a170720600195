"""Residuals of a node and the gap: their size in units of the declared noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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

    def list_squares(self, mask: NDArray[np.bool_] | None = None) -> Iterator[tuple[Array, Array]]:
        """Yield times, (n,) s, and squares over declared noise, (n,), of each channel and each random walk.

        mask: (N,) samples to include; None for all
        """
        selected = np.ones(len(self.node.t), np.bool_) if mask is None else mask
        for row in np.flatnonzero(self.node.used):
            z = self.value[row, selected] / self.declared_channel_sigma(row)[selected]
            yield self.node.t[selected], z**2
        samples = self.walk_steps.samples
        is_selected = selected[samples]
        for steps in self.walk_steps.steps:
            yield self.node.t[samples[is_selected]], steps[is_selected] ** 2

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
        for _t, squares in residual.list_squares(None if masks is None else masks[name]):
            total, count = total + float(squares.sum()), count + squares.size
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
