"""The demo's vehicle and drive: what the two virtual nodes are moved through, and the true path."""

import math
from dataclasses import dataclass

import numpy as np

from hubodo.log.recording import Table
from hubodo.model.chain import SensorErrors
from hubodo.model.drive import Drive, loop_drive
from hubodo.model.frames import Side
from hubodo.model.kinematics import WheelMount
from hubodo.model.wheel_motion import WheelMotion

WHEEL_RADIUS = 0.165
TRACK_WIDTH = 0.55
SIDES: tuple[Side, Side] = ("left", "right")
# LSM6DS33 data sheet: 7 mdps/√Hz and 90 µg/√Hz; at 416 Hz half of that is the bandwidth.
_BANDWIDTH_HZ = 208.0
_GYRO_NOISE = math.radians(0.007) * math.sqrt(_BANDWIDTH_HZ)
_ACCEL_NOISE = 90e-6 * 9.80665 * math.sqrt(_BANDWIDTH_HZ)
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
class Part:
    """One specimen of the chip: how far it is from its data sheet."""

    odr_error: float
    clock_ppm: float
    errors: SensorErrors


@dataclass(frozen=True)
class Scenario:
    """A seeded demo: the drive, the mounts and the specimens on both wheels."""

    seed: int
    drive: Drive
    mounts: dict[Side, WheelMount]
    parts: dict[Side, Part]
    start_angles: dict[Side, float]

    def motion(self, side: Side, start: float) -> WheelMotion:
        """What the node on one wheel feels; the drive begins at `start` s of chip time."""
        return WheelMotion(self.drive, self.mounts[side], start, self.start_angles[side])

    def length(self) -> float:
        """Length of the true path, m."""
        _, x, y, _ = self.drive.path()
        return float(np.sum(np.hypot(np.diff(x), np.diff(y))))

    def truth(self, t_start: float) -> Table:
        """The true path, with the drive beginning at `t_start` s."""
        t, x, y, heading = self.drive.path()
        speed = self.drive.body(t).speed
        return Table({"t": t + t_start, "x": x, "y": y, "heading": heading, "speed": speed})


def make_scenario(seed: int, moving: float) -> Scenario:
    """A demo drawn from a seed; `moving` s of drive between two rests."""
    rng = np.random.default_rng(seed)
    drive = loop_drive(rng, rest=8.0, moving=moving)

    def specimen() -> Part:
        bias = [float(value) for value in rng.normal(0.0, _ZERO_RATE, 3)]
        errors = SensorErrors(_GYRO_NOISE, _ACCEL_NOISE, (bias[0], bias[1], bias[2]))
        return Part(float(rng.uniform(-0.05, 0.05)), float(rng.uniform(-50.0, 50.0)), errors)

    radius = WHEEL_RADIUS * (1.0 + float(rng.normal(0.0, _RADIUS_ERROR)))
    track = TRACK_WIDTH * (1.0 + float(rng.normal(0.0, _TRACK_ERROR)))
    return Scenario(
        seed,
        drive,
        {side: WheelMount(side, "left", radius, track) for side in SIDES},
        {side: specimen() for side in SIDES},
        {side: float(rng.uniform(-np.pi, np.pi)) for side in SIDES},
    )
