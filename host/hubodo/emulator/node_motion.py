"""The forward model as the motion of an emulated chip: what a node on a drive feels and sends."""

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

# Earth's field where a drive takes place: horizontal part northwards (x at the start), the rest down.
_EARTH_FIELD = np.array([20e-6, 0.0, -44e-6])
# A wheel turns by less than 0.05 rad in it; a cubic between such points is off by some 1e-8 of the signal.
_STEP = 1e-3


@dataclass(frozen=True)
class NodeMotion:
    """What one node feels, with every effect up to the sensor's noise, as a function of chip time.

    wheel_radius, track_width: nominal, m. delay: s of chip time at which the drive begins; before it the
    vehicle rests as it stood. seed: of what wanders. Implements `hubodo.emulator.motion.Motion`.
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
        return self.delay + self.inputs.speed.end

    def angular_rate(self, t: Array) -> Array:
        """(n, 3) rad/s, as the gyro feels it."""
        return self._at(t, self._felt)[:, :3]

    def specific_force(self, t: Array) -> Array:
        """(n, 3) m/s², as the accelerometer feels it."""
        return self._at(t, self._felt)[:, 3:6]

    def temperature(self, t: Array) -> Array:
        """(n,) °C."""
        return self.inputs.temperature.at(t - self.delay)

    def magnetic_field(self, t: Array) -> Array:
        """(n, 3) T: the Earth's field, turned with the vehicle, the wheel and the node."""
        angle, heading = self._at(t, self._felt)[:, 6:].T
        cos, sin = np.cos(heading), np.sin(heading)
        x, y, z = _EARTH_FIELD
        felt: Array = np.stack([cos * x + sin * y, -sin * x + cos * y, np.full(len(t), z)], axis=1)
        if self.mount.side is None or self.mount.facing is None:
            felt = Rotation.from_rotvec(self.start.attitude).inv().apply(felt)
        else:
            camber = self._forward(t[:0]).geometry(self.effects).camber
            turn = node_from_body(angle, self.mount.side, self.mount.facing, camber)
            felt = np.einsum("nij,nj->ni", turn, felt)
        chain = _chain(t, np.zeros((len(t), 3)), felt)
        for effect in self.effects:
            effect.rotate_into_node(chain)
        return np.asarray(chain.force.T)

    def _at(self, t: Array, felt: BSpline) -> Array:
        return np.asarray(felt(np.clip(t, 0.0, felt.t[-1])))

    def _forward(self, t: Array) -> NodeModel:
        return NodeModel(
            self.inputs, t, self.mount, self.wheel_radius, self.track_width, power_on=-self.delay
        )

    @cached_property
    def _felt(self) -> BSpline:
        """Rate, force, wheel angle and heading, 8 columns, of chip time; made on the first question."""
        count = max(8, int(np.ceil(self.duration / _STEP)) + 1)
        chip: Array = np.linspace(0.0, (count - 1) * _STEP, count)
        forward = self._forward(chip - self.delay)
        reading = forward.draw_noise_free(self.effects, self.start, np.random.default_rng(self.seed))
        angle = np.zeros(len(chip)) if reading.rolling is None else reading.rolling.angle
        columns = [*reading.gyro, *reading.accel, angle, reading.body.heading]
        return make_interp_spline(chip, np.stack(columns, axis=1), 3)


@dataclass(frozen=True)
class Scatter:
    """Noise and what comes after it, sample by sample: the disturbance of an emulated chip.

    Samples that repeat are drawn within one run of samples; the first of a run is fresh.
    """

    noise: Noise
    effects: tuple[Effect, ...] = ()

    def __call__(self, t: Array, gyro: Array, accel: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """The motion as it is sent; t: (n,) s, gyro: (n, 3) rad/s, accel: (n, 3) m/s²."""
        chain = _chain(t, gyro, accel)
        add_noise_and_limits(chain, self.effects, self.noise, rng)
        return chain.gyro.T, chain.accel.T


def _chain(t: Array, gyro: Array, accel: Array) -> SensorChain:
    rate, force = np.ascontiguousarray(gyro.T), np.ascontiguousarray(accel.T)
    return SensorChain(t, np.full(len(t), 25.0), rate, np.zeros_like(rate), force, rate.copy(), force.copy())
