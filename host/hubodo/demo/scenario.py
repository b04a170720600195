"""The demo's vehicle, drive and sensor errors, drawn from a seed."""

import math
from dataclasses import dataclass

import numpy as np

from hubodo.demo.simulated_drive import DRIVE_START_S, SimulatedNode
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

WHEEL_RADIUS = 0.165  # m
TRACK_WIDTH = 0.55  # m
SIDES: tuple[Side, Side] = ("left", "right")
# LSM6DS33 data sheet: noise density 7 mdps/√Hz and 90 µg/√Hz; the bandwidth is half the rate of 416 Hz.
_BANDWIDTH_HZ = 208.0
SENSOR_NOISE = Noise(
    math.radians(0.007) * math.sqrt(_BANDWIDTH_HZ), 90e-6 * 9.80665 * math.sqrt(_BANDWIDTH_HZ)
)
BIAS_SIGMA = math.radians(1.5)  # rad/s; zero-rate level of the data sheet
# Relative 1σ of a tape measure: tyres deform under load, and the contact patch is wide.
_RADIUS_SIGMA, _TRACK_SIGMA = 0.002, 0.004

VEHICLE_TOML = f"""\
# The demo's vehicle: track width by tape, radius by rolling a known distance.
[vehicle]
wheel_radius = {WHEEL_RADIUS}     # m
radius_from = "rolled"   # 1 sigma of 0.3 %
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
    """The deviations of one sensor and wheel from their nominal values.

    Attributes
    ----------
    odr_error
        Relative error of the sensor's output data rate.
    clock_ppm
        Error of the board's clock, ppm.
    effects
        Geometry and bias errors.
    start_angle
        Wheel angle at power-on, rad.
    """

    odr_error: float
    clock_ppm: float
    effects: tuple[Effect, ...]
    start_angle: float


@dataclass(frozen=True)
class Scenario:
    """A seeded demo: the drive, and the errors of both wheel units."""

    seed: int
    drive: MotionInputs
    wheel_units: dict[Side, WheelUnit]

    def simulated_nodes(self) -> dict[str, SimulatedNode]:
        """Return the simulated nodes by name."""
        return {side: self._simulated_node(side, unit) for side, unit in self.wheel_units.items()}

    def _simulated_node(self, side: Side, unit: WheelUnit) -> SimulatedNode:
        mount, start = NodeMount(side, "left"), NodeInitialState(unit.start_angle)
        motion = NodeMotion(self.drive, mount, WHEEL_RADIUS, TRACK_WIDTH, unit.effects, start, DRIVE_START_S)
        return SimulatedNode(motion, SensorDisturbance(SENSOR_NOISE), unit.odr_error, unit.clock_ppm)

    def path_length(self) -> float:
        """Return the length of the true path, m."""
        _, x, y, _ = integrate_path(self.drive)
        return float(np.sum(np.hypot(np.diff(x), np.diff(y))))

    def truth(self, t_start: float) -> Table:
        """Return the true path for a drive that starts at `t_start` s."""
        t, x, y, heading = integrate_path(self.drive)
        return Table({"t": t + t_start, "x": x, "y": y, "heading": heading, "speed": self.drive.speed(t)})


def make_scenario(seed: int, drive_duration: float) -> Scenario:
    """Return a demo drawn from a seed, with a drive of `drive_duration` s between two standstills."""
    rng = np.random.default_rng(seed)
    drive = loop_drive(rng, rest_time=8.0, driving_time=drive_duration)
    size_errors = (
        TrackWidth(float(rng.normal(0.0, _TRACK_SIGMA))),
        WheelRadius(float(rng.normal(0.0, _RADIUS_SIGMA))),
    )

    def draw_unit() -> WheelUnit:
        bias = GyroBias(*(float(value) for value in rng.normal(0.0, BIAS_SIGMA, 3)))
        return WheelUnit(
            float(rng.uniform(-0.05, 0.05)),
            float(rng.uniform(-50.0, 50.0)),
            (*size_errors, bias),
            float(rng.uniform(-np.pi, np.pi)),
        )

    return Scenario(seed, drive, {side: draw_unit() for side in SIDES})
