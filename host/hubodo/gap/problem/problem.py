"""The data of a search: readings of each node and the inputs that drive its model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.gap.problem.saturation import is_at_limit, weigh_speed_sources
from hubodo.model.forward import NodeModel
from hubodo.model.inputs import MotionInputs
from hubodo.model.model_file import Model
from hubodo.smoothing_spline import LowPass
from hubodo.vehicle import NodeMount, facing_sign

CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")
# Nodes with fewer samples are ignored.
MIN_NODE_SAMPLES = 100
# Hz, smallest rate after decimation; faster motion of wheels and vehicles does not help to distinguish
# effects.
_MIN_DECIMATED_RATE_HZ = 100.0
# Smaller steps between readings are rounding of the file, not the resolution of the sensor.
MIN_LATTICE_STEP = 1e-8


@dataclass(frozen=True)
class NodeData:
    """Readings of one node.

    t: (N,) s since the start of the log
    y: (6, N) gx gy gz in rad/s, ax ay az in m/s²
    used: (6,) channels that take part; a channel that never changes is excluded
    saturation_limits: limits of gyro, rad/s, and accelerometer, m/s²; infinite if no readings pile up at a
        limit
    """

    name: str
    mount: NodeMount
    t: Array
    y: Array
    used: NDArray[np.bool_]
    saturation_limits: tuple[float, float]
    forward: NodeModel

    @cached_property
    def is_saturated(self) -> NDArray[np.bool_]:
        """Return a mask, (6, N), of the readings at the limit of their sensor."""
        return is_at_limit(self.y, np.repeat(self.saturation_limits, 3)[:, None])

    @property
    def on_wheel(self) -> bool:
        return self.mount.side is not None

    @cached_property
    def accel_scatter(self) -> float:
        """Return 1 sigma of white noise in ax and ay, m/s², estimated from second differences."""
        differences = np.diff(self.y[3:5], 2, axis=1)
        return float(np.median(np.abs(differences)) / 0.6745 / np.sqrt(6.0))

    @cached_property
    def lattice_steps(self) -> Array:
        """Return the smallest step between two readings of each channel, (6,); infinity if all are equal."""
        gaps = [np.diff(np.unique(np.round(row, 9))) for row in self.y]
        return np.array([one[one > MIN_LATTICE_STEP].min(initial=np.inf) for one in gaps])

    def select(self, samples: slice) -> NodeData:
        """Return a copy with some of the samples."""
        return replace(self, t=self.t[samples], y=self.y[:, samples], forward=self.forward.select(samples))

    def decimate(self) -> NodeData:
        """Return a copy with every k-th sample, at 100 to 200 Hz; itself if it is not faster."""
        stride = int(1.0 / (_MIN_DECIMATED_RATE_HZ * float(np.median(np.diff(self.t)))) + 1e-6)
        if stride < 2:
            return self
        t = np.ascontiguousarray(self.t[::stride])
        full = self.forward
        forward = NodeModel(full.inputs, t, self.mount, full.wheel_radius, full.track_width, full.power_on)
        return replace(self, t=t, y=np.ascontiguousarray(self.y[:, ::stride]), forward=forward)


@dataclass(frozen=True)
class Problem:
    """The data of a search for effects.

    speed_noise, yaw_rate_noise: m/s and rad/s, 1 sigma of one sample of the inputs
    speed_period, yaw_rate_period: s between samples of the inputs
    speed_sources: names of the nodes whose z gyro is the speed input; () with a reference
    warnings: remarks for the user, one line each
    yaw_rate_offset_sigma: rad/s, 1 sigma of a constant error of the yaw rate input
    """

    model: Model
    nodes: tuple[NodeData, ...]
    inputs: MotionInputs
    speed_noise: float
    yaw_rate_noise: float
    speed_period: float
    yaw_rate_period: float
    duration: float
    speed_sources: tuple[str, ...]
    warnings: tuple[str, ...]
    yaw_rate_offset_sigma: float = 0.0

    @cached_property
    def speed_source_nodes(self) -> tuple[NodeData, ...]:
        """Return the nodes whose gyros measured the speed."""
        return tuple(node for node in self.nodes if node.name in self.speed_sources and node.on_wheel)

    @cached_property
    def speed_weights(self) -> Array:
        """Return the weights of these gyros in the measured speed, (S, N), at the stamps of the first."""
        nodes = self.speed_source_nodes
        return weigh_speed_sources(nodes[0].t, [(node.t, node.is_saturated[2]) for node in nodes])

    @cached_property
    def speed_filter(self) -> LowPass:
        """Return the filter of the measured speed, at the stamps of the first of these gyros."""
        return LowPass(self.speed_source_nodes[0].t, self.inputs.speed.cutoff)

    @cached_property
    def wheel_speeds(self) -> Mapping[str, Array]:
        """Return the speed that each of these gyros measured, (N,) m/s, smoothed like their mean."""
        return {
            node.name: LowPass(node.t, self.inputs.speed.cutoff).apply(
                facing_sign(node.mount.facing or "left") * node.forward.wheel_radius * node.y[2]
            )
            for node in self.speed_source_nodes
        }

    def select(self, samples: Mapping[str, slice]) -> Problem:
        """Return a copy with some samples of each node."""
        return replace(self, nodes=tuple(node.select(samples[node.name]) for node in self.nodes))

    def decimate(self) -> Problem | None:
        """Return a copy with nodes at 100 to 200 Hz and complete inputs; None if no node is faster."""
        nodes = tuple(node.decimate() for node in self.nodes)
        if all(decimated is node for decimated, node in zip(nodes, self.nodes, strict=True)):
            return None
        return replace(self, nodes=nodes)
