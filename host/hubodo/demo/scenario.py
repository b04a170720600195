"""The demo's vehicle and drive: what the two virtual nodes are moved through, and the true path."""

import math
from dataclasses import dataclass

import numpy as np

from hubodo.demo.ride import SETTLE, Rider
from hubodo.effects import Effect, Noise
from hubodo.effects.gyro import GyroBias
from hubodo.effects.vehicle import TrackWidth
from hubodo.effects.wheel import WheelRadius
from hubodo.emulator.node_motion import NodeMotion, SensorDisturbance
from hubodo.model.drive import integrate_path, loop_drive
from hubodo.model.forward import NodeInitialState
from hubodo.model.inputs import MotionInputs
from hubodo.recording import Table
from hubodo.vehicle import NodeMount, Side

WHEEL_RADIUS = 0.165
TRACK_WIDTH = 0.55
SIDES: tuple[Side, Side] = ("left", "right")
# LSM6DS33 data sheet: 7 mdps/√Hz and 90 µg/√Hz; at 416 Hz half of that is the bandwidth.
_BANDWIDTH_HZ = 208.0
_NOISE = Noise(math.radians(0.007) * math.sqrt(_BANDWIDTH_HZ), 90e-6 * 9.80665 * math.sqrt(_BANDWIDTH_HZ))
_ZERO_RATE = math.radians(1.5)
# How far a tape measure is from the truth, 1 sigma: a tyre gives under load, contacts are wide.
_RADIUS_ERROR, _TRACK_ERROR = 0.002, 0.004

VEHICLE_TOML = f"""\
# The demo's vehicle: as a tape measure would give it.
[vehicle]
wheel_radius = {WHEEL_RADIUS}     # m
track_width = {TRACK_WIDTH}       # m, between contacts

[nodes.left]
side = "left"
facing = "left"

[nodes.right]
side = "right"
facing = "left"
"""


@dataclass(frozen=True)
class WheelUnit:
    """One specimen of the chip on one wheel: how far both are from their data sheet."""

    odr_error: float
    clock_ppm: float
    effects: tuple[Effect, ...]
    start_angle: float


@dataclass(frozen=True)
class Scenario:
    """A seeded demo: the drive and the specimens on both wheels."""

    seed: int
    drive: MotionInputs
    parts: dict[Side, WheelUnit]

    def riders(self) -> dict[str, Rider]:
        """What goes on the ride, by node."""
        return {side: self._rider(side, part) for side, part in self.parts.items()}

    def _rider(self, side: Side, part: WheelUnit) -> Rider:
        mount, start = NodeMount(side, "left"), NodeInitialState(part.start_angle)
        motion = NodeMotion(self.drive, mount, WHEEL_RADIUS, TRACK_WIDTH, part.effects, start, SETTLE)
        return Rider(motion, SensorDisturbance(_NOISE), part.odr_error, part.clock_ppm)

    def length(self) -> float:
        """Length of the true path, m."""
        _, x, y, _ = integrate_path(self.drive)
        return float(np.sum(np.hypot(np.diff(x), np.diff(y))))

    def truth(self, t_start: float) -> Table:
        """The true path, with the drive beginning at `t_start` s."""
        t, x, y, heading = integrate_path(self.drive)
        return Table({"t": t + t_start, "x": x, "y": y, "heading": heading, "speed": self.drive.speed(t)})


def make_scenario(seed: int, moving: float) -> Scenario:
    """A demo drawn from a seed; `moving` s of drive between two rests."""
    rng = np.random.default_rng(seed)
    drive = loop_drive(rng, rest_time=8.0, driving_time=moving)
    sizes = (
        TrackWidth(float(rng.normal(0.0, _TRACK_ERROR))),
        WheelRadius(float(rng.normal(0.0, _RADIUS_ERROR))),
    )

    def specimen() -> WheelUnit:
        bias = GyroBias(*(float(value) for value in rng.normal(0.0, _ZERO_RATE, 3)))
        return WheelUnit(
            float(rng.uniform(-0.05, 0.05)),
            float(rng.uniform(-50.0, 50.0)),
            (*sizes, bias),
            float(rng.uniform(-np.pi, np.pi)),
        )

    return Scenario(seed, drive, {side: specimen() for side in SIDES})
