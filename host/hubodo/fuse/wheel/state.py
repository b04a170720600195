"""Where the wheel filter starts: its states, what is known of them, and the book kept for each wheel."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field

import numpy as np

from hubodo.arrays import Array
from hubodo.fuse.wheel import phase
from hubodo.fuse.wheel.config import WheelConfig, WheelNode, WheelPrior
from hubodo.fuse.wheel.phase import VEHICLE_STATES, WHEEL_STATES, WheelGeometry
from hubodo.fuse.wheel.preintegration import Window
from hubodo.fuse.wheel.zero_velocity import RestDetector

FORGET = 20
"""Windows without a sample after which a wheel angle is no longer believed."""

ANGLE_SIGMA = 0.3
"""rad, of an angle read from gravity while the vehicle may accelerate by a third of it."""


_LOST_ANGLE = 0.7
"""rad by which gravity may seem to have turned over a gap; beyond it the wheel angle is found anew."""

_LOOK = 3
"""Windows after a gap that are looked at for it."""


@dataclass
class Wheel:
    """One wheel: its place in the state vector, and counts that a report is made of.

    joined: its angle is known. turned: rad in all, forwards: rad net. upright: sum over `moving` windows of
    the force that points up, in units of g. slips, clipped, unheard_in_all: windows. lost: times that the
    wheel angle was lost over a gap.
    """

    name: str
    node: WheelNode
    geometry: WheelGeometry
    rest: RestDetector
    first: int
    joined: bool = False
    trusted: bool = True
    heard: int = 0
    unheard: int = 0
    level: complex = 0j
    axial: float = 0.0
    begin: float = 0.0
    spin: float = 0.0
    turned: float = 0.0
    forwards: float = 0.0
    upright: float = 0.0
    moving: int = 0
    slips: int = 0
    clipped: int = 0
    unheard_in_all: int = 0
    lost: int = 0
    _before: complex = 0j
    _after: complex = 0j
    _looked: int | None = None

    def listen(self, window: Window) -> None:
        """Gathers gravity, carried along with the spin, until the wheel angle can be read from it."""
        if window.missing > 0.5:
            self.unheard += 1
            self.unheard_in_all += 1
            if self.unheard >= FORGET:
                self._forget()
            self._after, self._looked = 0j, 0
            return
        self.unheard = 0
        if self.joined:
            self._compare(window)
            return
        if self.heard == 0:
            self.begin = window.clock_angle - 0.5 * window.spin
        self.heard += 1
        self.level += window.force * cmath.exp(1j * window.clock_angle)
        self.axial += window.axial
        self.spin = window.clock_angle + 0.5 * window.spin

    def _compare(self, window: Window) -> None:
        """Forgets the angle when gravity lies elsewhere after a gap: the clock jumped, or the wheel did not
        turn as the straight line across the gap has it."""
        level = window.force * cmath.exp(1j * window.clock_angle)
        if self._looked is None or self._before == 0j:
            self._looked = None
            self._before = 0.8 * self._before + 0.2 * level
            return
        self._after, self._looked = self._after + level, self._looked + 1
        if self._looked < _LOOK:
            return
        turned = abs(cmath.phase(self._after * self._before.conjugate()))
        self._before, self._looked = self._after / _LOOK, None
        if turned > _LOST_ANGLE:
            self.lost += 1
            self._forget()

    def _forget(self) -> None:
        self.joined, self.heard, self.level, self.axial = False, 0, 0j, 0.0
        self._before = 0j

    def join(self, x: list[float], p: Array, at_begin: bool) -> None:
        """Wheel angle from gravity: a force e^(-i theta) carried by e^(ic) points along e^(-i(theta - c)).

        at_begin: the angle where listening began, else where it ended.
        """
        first = self.first
        angle = -cmath.phase(self.level) + (self.begin if at_begin else self.spin)
        x[first + phase.ANGLE] = math.remainder(angle, 2.0 * math.pi)
        if x[first + phase.CAMBER] == 0.0:
            x[first + phase.CAMBER] = self.geometry.side * math.atan2(self.axial, abs(self.level))
        place = first + phase.ANGLE
        p[place, :] = 0.0
        p[:, place] = 0.0
        p[place, place] = ANGLE_SIGMA**2
        self.joined = True


@dataclass
class Start:
    """The states and their covariance before the first window, and the variance by which each wanders in a
    second."""

    x: list[float]
    p: Array
    walk: Array
    wheels: list[Wheel] = field(default_factory=list)


def start(config: WheelConfig) -> Start:
    """States at rest at the origin, with the priors and the calibration of `config`."""
    size = VEHICLE_STATES + len(config.nodes) * WHEEL_STATES
    made = Start([0.0] * size, np.zeros((size, size)), np.zeros(size))
    made.x[phase.HEADING], made.x[phase.TRACK] = config.start_heading, config.track_error
    two = len(config.nodes) == 2
    vehicle = {
        phase.HEADING: (config.heading_sigma, 0.0),
        phase.SPEED: (1.0, 0.0),
        phase.YAW_RATE: (0.5, 0.0),
        phase.TRACK: (config.track_sigma, 0.0),
        phase.CLOCK: (config.clock_sigma, 5e-5) if two else (0.0, 0.0),
        phase.SLOPE: (config.noise.slope, 0.0),
    }
    for state, pair in vehicle.items():
        _set(made, state, *pair)
    for index, (name, node) in enumerate(config.nodes.items()):
        side = 1.0 if node.side == "left" else -1.0
        geometry = WheelGeometry(side, config.radius, 0.5 * side * config.track_width, float(index))
        first = VEHICLE_STATES + index * WHEEL_STATES
        made.wheels.append(Wheel(name, node, geometry, RestDetector(config.rest), first))
        for state, pair in _prior(node.prior, config.noise.gyro).items():
            _set(made, first + state, *pair)
        for state, quantity in node.known.items():
            made.x[first + state] = quantity.value
            made.p[first + state, first + state] = quantity.sigma**2
    return made


def _set(made: Start, place: int, sigma: float, wander: float) -> None:
    made.p[place, place] = sigma * sigma
    made.walk[place] = wander * wander


def _prior(prior: WheelPrior, gyro: float) -> dict[int, tuple[float, float]]:
    """State -> (1 sigma at the start, wander per square root of a second)."""
    return {
        phase.ANGLE: (ANGLE_SIGMA, gyro),
        phase.SPIN_SCALE: (prior.spin_scale, prior.scale_walk),
        phase.SPIN_BIAS: (prior.bias, prior.bias_walk),
        phase.BIAS_X: (prior.bias, prior.bias_walk),
        phase.BIAS_Y: (prior.bias, prior.bias_walk),
        phase.TILT_X: (prior.tilt, 1e-6),
        phase.TILT_Y: (prior.tilt, 1e-6),
        phase.ARM_X: (prior.arm, 1e-6),
        phase.ARM_Y: (prior.arm, 1e-6),
        phase.FORCE_X: (prior.force, prior.force_walk),
        phase.FORCE_Y: (prior.force, prior.force_walk),
        phase.FORCE_Z: (prior.force, 10.0 * prior.force_walk),
        phase.CAMBER: (prior.camber, 1e-5),
        phase.YAW_SCALE: (prior.yaw_scale, prior.scale_walk),
        phase.YAW_BIAS: (prior.yaw_bias, 1e-6),
        phase.RADIUS: (prior.radius, prior.radius_walk),
        phase.LEAK_X: (prior.tilt, 1e-6),
        phase.LEAK_Y: (prior.tilt, 1e-6),
        phase.EXCESS: (0.0, 0.0),
    }
