"""A log and a model brought together: what each node measured, and what drives the model of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.model.forward import NodeModel
from hubodo.model.inputs import MotionInputs
from hubodo.model.model_file import Model
from hubodo.vehicle import NodeMount

CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")
# Hz: wheels and vehicles do nothing faster that an effect would need to be told from another.
_ENOUGH = 100.0
# A step between readings that is no rounding of the file.
_DIGIT = 1e-8


@dataclass(frozen=True)
class NodeData:
    """What one node measured. t: (N,) s since the log began. y: (6, N) gx gy gz rad/s, ax ay az m/s².

    used: (6,) which channels take part; a channel that never changes says nothing. limits: of gyro rad/s and
    accelerometer m/s², beyond which nothing was read as it seems; infinity where nothing piles up.
    """

    name: str
    mount: NodeMount
    t: Array
    y: Array
    used: NDArray[np.bool_]
    limits: tuple[float, float]
    forward: NodeModel

    @cached_property
    def clipped(self) -> NDArray[np.bool_]:
        """(6, N): readings at the limit of their sensor."""
        limits = np.repeat(self.limits, 3)[:, None]
        return np.asarray(np.abs(self.y) >= limits * (1.0 - 1e-9))

    @property
    def on_wheel(self) -> bool:
        return self.mount.side is not None

    @cached_property
    def accel_scatter(self) -> float:
        """m/s²: 1 sigma of white noise in ax and ay, from their second differences, whatever is declared."""
        bent = np.diff(self.y[3:5], 2, axis=1)
        return float(np.median(np.abs(bent)) / 0.6745 / np.sqrt(6.0))

    @cached_property
    def steps(self) -> Array:
        """(6,): the smallest step between two readings of a channel; infinity where all are equal."""
        gaps = [np.diff(np.unique(np.round(row, 9))) for row in self.y]
        return np.array([one[one > _DIGIT].min(initial=np.inf) for one in gaps])

    def part(self, samples: slice) -> NodeData:
        """Some of its samples."""
        return replace(self, t=self.t[samples], y=self.y[:, samples], forward=self.forward.select(samples))

    def decimated(self) -> NodeData:
        """Every k-th sample of it, at 100 to 200 Hz; itself where it is not faster."""
        every = int(1.0 / (_ENOUGH * float(np.median(np.diff(self.t)))) + 1e-6)
        if every < 2:
            return self
        t = np.ascontiguousarray(self.t[::every])
        was = self.forward
        forward = NodeModel(was.inputs, t, self.mount, was.wheel_radius, was.track_width, was.power_on)
        return replace(self, t=t, y=np.ascontiguousarray(self.y[:, ::every]), forward=forward)


@dataclass(frozen=True)
class Problem:
    """Everything a search for effects works on.

    speed_noise m/s, yaw_rate_noise rad/s: 1 sigma of a sample of the inputs. speed_period, yaw_rate_period: s
    between those. measured_by: nodes whose z gyro is the speed input, () when the log has a reference.
    warnings: one line each.
    """

    model: Model
    nodes: tuple[NodeData, ...]
    inputs: MotionInputs
    speed_noise: float
    yaw_rate_noise: float
    speed_period: float
    yaw_rate_period: float
    duration: float
    measured_by: tuple[str, ...]
    warnings: tuple[str, ...]

    @cached_property
    def sources(self) -> tuple[NodeData, ...]:
        """The nodes whose gyros measured the speed."""
        return tuple(node for node in self.nodes if node.name in self.measured_by and node.on_wheel)

    def part(self, samples: Mapping[str, slice]) -> Problem:
        """With some samples of each node."""
        return replace(self, nodes=tuple(node.part(samples[node.name]) for node in self.nodes))

    def decimated(self) -> Problem | None:
        """The same with nodes at 100 to 200 Hz, to be searched first; None where none is faster.

        The inputs are left whole.
        """
        nodes = tuple(node.decimated() for node in self.nodes)
        if all(one is node for one, node in zip(nodes, self.nodes, strict=True)):
            return None
        return replace(self, nodes=nodes)
