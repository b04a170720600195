"""Motion of an emulated node from the forward model, with every effect ahead of the sensor noise."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from hubodo.arrays import Array
from hubodo.effects import Effect, Noise, SensorChain
from hubodo.model.forward import NodeInitialState, NodeModel, add_noise_and_limits
from hubodo.model.frames import node_from_body
from hubodo.model.inputs import MotionInputs
from hubodo.vehicle import NodeMount

# Magnetic field of the Earth at mid-latitudes, T: horizontal part to the north (initial x), the rest down.
_EARTH_FIELD_T = np.array([20e-6, 0.0, -44e-6])
# A wheel turns by less than 0.05 rad per step: the error of a cubic spline is about 1e-8 of the signal.
_MOTION_STEP_S = 1e-3


@dataclass(frozen=True)
class NodeMotion:
    """Motion of one node as a function of chip time, with effects; implements `motion.Motion`.

    Attributes
    ----------
    inputs : motion of the vehicle.
    mount : wheel and orientation of the node.
    wheel_radius, track_width : m, nominal.
    effects : effects of the node.
    start : initial state of the node.
    delay : s of chip time at which the drive begins; before it the vehicle is at standstill.
    seed : seed of random walks.
    """

    inputs: MotionInputs
    mount: NodeMount
    wheel_radius: float
    track_width: float
    effects: tuple[Effect, ...] = ()
    start: NodeInitialState = field(default_factory=NodeInitialState)
    delay: float = 0.0
    seed: int = 0

    @property
    def duration(self) -> float:
        """Chip time at the end of the drive, s."""
        return self.delay + self.inputs.speed.end

    def angular_rate(self, t: Array) -> Array:
        """Return the rate at the gyro, (n, 3) rad/s."""
        return self._evaluate(t, self._signals)[:, :3]

    def specific_force(self, t: Array) -> Array:
        """Return the specific force at the accelerometer, (n, 3) m/s²."""
        return self._evaluate(t, self._signals)[:, 3:6]

    def temperature(self, t: Array) -> Array:
        """Return the temperature of the sensor, (n,) °C."""
        return self.inputs.temperature.at(t - self.delay)

    def magnetic_field(self, t: Array) -> Array:
        """Return the magnetic field of the Earth in node axes, (n, 3) T."""
        angle, heading = self._evaluate(t, self._signals)[:, 6:].T
        cos, sin = np.cos(heading), np.sin(heading)
        x, y, z = _EARTH_FIELD_T
        field_vectors: Array = np.stack([cos * x + sin * y, -sin * x + cos * y, np.full(len(t), z)], axis=1)
        if self.mount.side is None or self.mount.facing is None:
            field_vectors = Rotation.from_rotvec(self.start.attitude).inv().apply(field_vectors)
        else:
            camber = self._node_model(t[:0]).geometry(self.effects).camber
            rotation = node_from_body(angle, self.mount.side, self.mount.facing, camber)
            field_vectors = np.einsum("nij,nj->ni", rotation, field_vectors)
        chain = _chain(t, np.zeros((len(t), 3)), field_vectors)
        for effect in self.effects:
            effect.rotate_into_node(chain)
        return np.asarray(chain.force.T)

    def _evaluate(self, t: Array, spline: BSpline) -> Array:
        """Evaluate a spline at t, clipped to its interval."""
        return np.asarray(spline(np.clip(t, 0.0, spline.t[-1])))

    def _node_model(self, t: Array) -> NodeModel:
        """Return the forward model of the node at t since the start of the drive."""
        return NodeModel(
            self.inputs, t, self.mount, self.wheel_radius, self.track_width, power_on=-self.delay
        )

    @cached_property
    def _signals(self) -> BSpline:
        """Spline of rate, force, wheel angle and heading over chip time, 8 columns; built on first use."""
        count = max(8, int(np.ceil(self.duration / _MOTION_STEP_S)) + 1)
        chip_time: Array = np.linspace(0.0, (count - 1) * _MOTION_STEP_S, count)
        model = self._node_model(chip_time - self.delay)
        reading = model.draw_noise_free(self.effects, self.start, np.random.default_rng(self.seed))
        angle = np.zeros(len(chip_time)) if reading.rolling is None else reading.rolling.angle
        columns = [*reading.gyro, *reading.accel, angle, reading.body.heading]
        return make_interp_spline(chip_time, np.stack(columns, axis=1), 3)


@dataclass(frozen=True)
class SensorDisturbance:
    """Sensor noise, range and resolution as the disturbance of an emulated chip.

    Repeated samples are drawn within one run of samples; the first of a run is never repeated.
    """

    noise: Noise
    effects: tuple[Effect, ...] = ()

    def __call__(self, t: Array, gyro: Array, accel: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return the disturbed readings; t: (n,) s, gyro: (n, 3) rad/s, accel: (n, 3) m/s²."""
        chain = _chain(t, gyro, accel)
        add_noise_and_limits(chain, self.effects, self.noise, rng)
        return chain.gyro.T, chain.accel.T


def _chain(t: Array, gyro: Array, accel: Array) -> SensorChain:
    """Return a sensor chain with these readings; gyro and accel are (n, 3)."""
    rate, force = np.ascontiguousarray(gyro.T), np.ascontiguousarray(accel.T)
    return SensorChain(t, np.full(len(t), 25.0), rate, np.zeros_like(rate), force, rate.copy(), force.copy())
