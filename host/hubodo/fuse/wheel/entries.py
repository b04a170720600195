"""The state of the wheel filter: a list of entries, each a parameter of an effect or a process of the drive.

What is believed of a parameter beforehand, how it wanders and what sign it has on a node facing right stands
in its effect, with its origin. The filter turns every node to face left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.accel import AccelBias, AccelNonorthogonality
from hubodo.effects.base import Effect
from hubodo.effects.gyro import GyroBias, GyroGSensitivity, GyroScaleFactor
from hubodo.effects.mounting import LeverArm, NodeMisalignment
from hubodo.effects.timing import TimeOffset
from hubodo.effects.vehicle import RoadGrade, TrackWidth
from hubodo.effects.wheel import WheelCamber, WheelRadius
from hubodo.vehicle import Facing

Scope = Literal["vehicle", "wheel"]


@dataclass(frozen=True, eq=False, slots=True)
class Entry:
    """One number of the state, of the vehicle or of each wheel with its node.

    effect, parameter: as in the model file; of a process, names that no effect has. prior: 1 sigma before
    the first sample; walk: how far it wanders per square root of a second. of: the effect, None of a
    process; parameters: those of the effect whose mean it is, most often one; factor: by which that mean is
    multiplied in the state. alone: whether nothing but that effect is in it, so that a calibration of the
    effect says what it is. forgets: s after which it is another one, with the prior for its size.

    There is one object of each entry and two are never equal: looking one up costs next to nothing.
    """

    scope: Scope
    effect: str
    parameter: str
    prior: float
    walk: float
    of: type[Effect] | None = None
    parameters: tuple[str, ...] = ()
    factor: float = 1.0
    alone: bool = True
    forgets: float = math.inf

    def __str__(self) -> str:
        return f"{self.effect}.{self.parameter}"

    def __deepcopy__(self, memo: Any) -> Entry:
        return self

    def sign(self, facing: Facing) -> float:
        """-1 where a node facing right has the negated parameter of one facing left, else +1."""
        return 1.0 if self.of is None else self.of.sign(self.parameters[0], facing)

    @property
    def remedy(self) -> str:
        """What to do so that a drive shows it; empty where nothing is known to."""
        estimate = None if self.of is None else self.of.estimate(self.parameters[0])
        return "" if estimate is None else estimate.shown_by

    @property
    def lasts(self) -> bool:
        """Whether it is a parameter that a drive can teach: no process, and not of the road underneath."""
        return self.of is not None and self.forgets == math.inf


def _of(
    scope: Scope, effect: type[Effect], *parameters: str, factor: float = 1.0, alone: bool = True
) -> Entry:
    """An entry with what its effect declares."""
    estimate = effect.estimate(parameters[0])
    assert estimate is not None, f"{effect.name}.{parameters[0]} is not estimated"
    prior, walk = estimate.prior * factor, estimate.walk * factor
    named = " ".join(parameters)
    return Entry(scope, effect.name, named, prior, walk, effect, parameters, factor, alone, estimate.forgets)


X = Entry("vehicle", "motion", "x", 0.0, 0.0)
"""m. The track begins at the origin."""

Y = Entry("vehicle", "motion", "y", 0.0, 0.0)
"""m."""

HEADING = Entry("vehicle", "motion", "heading", 0.0, 0.0)
"""rad, unwrapped. The track begins at a given heading."""

SPEED = Entry("vehicle", "motion", "speed", 1.0, 0.0)
"""m/s; walking pace before anything is seen. It steps from window to window: see step.py."""

YAW_RATE = Entry("vehicle", "motion", "yaw_rate", 0.5, 0.0)
"""rad/s; a brisk turn before anything is seen. It steps from window to window: see step.py."""

TRACK_WIDTH = _of("vehicle", TrackWidth, "error")
TIME_OFFSET = _of("vehicle", TimeOffset, "delay")
"""s by which the second node's time stamps are later than the first one's."""

SLOPE = _of("vehicle", RoadGrade, "angle", factor=STANDARD_GRAVITY)
"""m/s² of forward force that the road's slope makes."""

WHEEL_ANGLE = Entry("wheel", "rolling", "angle", 0.3, 0.0)
"""rad, of the node's x axis from upright, as gravity tells it.

The vehicle may accelerate by a third of gravity meanwhile. The angle wanders by the noise of the gyro that
carries it.
"""

GYRO_SCALE_Z = _of("wheel", GyroScaleFactor, "z")
GYRO_BIAS_Z = _of("wheel", GyroBias, "z")
GYRO_BIAS_X = _of("wheel", GyroBias, "x")
GYRO_BIAS_Y = _of("wheel", GyroBias, "y")
MISALIGNMENT_Y = _of("wheel", NodeMisalignment, "y")
MISALIGNMENT_X = _of("wheel", NodeMisalignment, "x")
LEVER_ARM_X = _of("wheel", LeverArm, "x")
LEVER_ARM_Y = _of("wheel", LeverArm, "y")
ACCEL_BIAS_X = _of("wheel", AccelBias, "x")
ACCEL_BIAS_Y = _of("wheel", AccelBias, "y")
ACCEL_BIAS_Z = _of("wheel", AccelBias, "z")
CAMBER = _of("wheel", WheelCamber, "angle")
GYRO_SCALE_ACROSS = _of("wheel", GyroScaleFactor, "x", "y")
GYRO_SCALE_DIFFERENCE = Entry("wheel", "gyro_across", "scale_difference", 0.0075, 2e-6)
"""Half of what the scale of gx is beyond that of gy; of both 1 % each, so that it is as large as their mean.

While a wheel turns slowly each curve is measured by another mixture of the two: turns have errors of their
own, which no common scale explains. No calibration tells it, as a wheel that turns fast shows the mean alone.
Walk: temperature, 0.012 % in an hour.
"""

YAW_RATE_FROM_GRAVITY = _of("wheel", GyroGSensitivity, "xx", "yy", factor=STANDARD_GRAVITY)
"""rad/s. Gravity turns with the wheel: what it makes in x and y adds up to one yaw rate."""

WHEEL_RADIUS = _of("wheel", WheelRadius, "error")
AXIAL_LEAK_X = _of("wheel", AccelNonorthogonality, "zy", alone=False)
"""How much of the force along x the axial accelerometer feels; a tilt of the node does the same."""

AXIAL_LEAK_Y = _of("wheel", AccelNonorthogonality, "zx", alone=False)
"""The same of the force along y, negated."""

EXCESS = Entry("wheel", "clipping", "excess", 0.0, 0.0)
"""rad/s about the axle that a clipped gyro does not show; zero while it shows all."""

ANTENNA_X = Entry("vehicle", "antenna", "x", 1.5, 0.0)
"""m forward of the body origin, of what is told where it is; anywhere on a car."""

ANTENNA_Y = Entry("vehicle", "antenna", "y", 0.5, 0.0)
"""m to the left; most stand in the middle."""

POSITION_DELAY = Entry("vehicle", "positions", "delay", 0.05, 0.0)
"""s by which the time stamps of the positions are later than the nodes'. Two clocks that somebody set."""

POSITION_ERROR_X = Entry("vehicle", "positions", "error_x", 0.1, 0.0, forgets=600.0)
"""m east, what changes slowly in a position's error: satellites that rise, reflections, a filter's memory.

Ten minutes: satellites move on; a jump lasts as well. How large it is the positions tell.
"""

POSITION_ERROR_Y = Entry("vehicle", "positions", "error_y", 0.1, 0.0, forgets=600.0)
"""m north."""

ENCODER_LEFT = Entry("vehicle", "encoder", "left", 0.01, 0.0)
"""By which share the surface speed that another odometer tells of the left wheel is too large: its radius."""

ENCODER_RIGHT = Entry("vehicle", "encoder", "right", 0.01, 0.0)

OF_VEHICLE = (X, Y, HEADING, SPEED, YAW_RATE, TRACK_WIDTH, TIME_OFFSET, SLOPE)
OF_WHEEL = (
    WHEEL_ANGLE,
    *(GYRO_SCALE_Z, GYRO_BIAS_Z, GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_Y, MISALIGNMENT_X),
    *(LEVER_ARM_X, LEVER_ARM_Y, ACCEL_BIAS_X, ACCEL_BIAS_Y, ACCEL_BIAS_Z, CAMBER, GYRO_SCALE_ACROSS),
    *(GYRO_SCALE_DIFFERENCE, YAW_RATE_FROM_GRAVITY, WHEEL_RADIUS, AXIAL_LEAK_X, AXIAL_LEAK_Y, EXCESS),
)
OF_POSITIONS = (ANTENNA_X, ANTENNA_Y, POSITION_DELAY, POSITION_ERROR_X, POSITION_ERROR_Y)
"""What there is besides where positions are told."""

OF_ENCODER = (ENCODER_LEFT, ENCODER_RIGHT)
"""What there is besides where another odometer tells surface speeds."""

SEEN_ROLLING = (
    *(GYRO_SCALE_Z, MISALIGNMENT_X, MISALIGNMENT_Y),
    *(LEVER_ARM_X, LEVER_ARM_Y, WHEEL_RADIUS, TIME_OFFSET),
)
"""What only a wheel that turns can show: these multiply its rate, which at rest is the noise of the gyro."""

SEEN_TURNING = (GYRO_SCALE_ACROSS, GYRO_SCALE_DIFFERENCE, TRACK_WIDTH)
"""What only a vehicle that turns can show: the same of the yaw rate."""

SEEN_BY_TWO = (TRACK_WIDTH, TIME_OFFSET)
"""What one wheel cannot show."""


class Columns:
    """Where each entry stands in the state, the vehicle's first, then those of each wheel.

    Worked out once, when a filter is built. told: whether it is told positions; encoder: surface speeds.
    """

    def __init__(self, wheels: int, told: bool = False, encoder: bool = False) -> None:
        of_vehicle = OF_VEHICLE + (OF_POSITIONS if told else ()) + (OF_ENCODER if encoder else ())
        self.vehicle = {entry: place for place, entry in enumerate(of_vehicle)}
        self.size = len(of_vehicle) + wheels * len(OF_WHEEL)
        self.wheels: list[dict[Entry, int]] = []
        for first in range(len(of_vehicle), self.size, len(OF_WHEEL)):
            own = {entry: first + place for place, entry in enumerate(OF_WHEEL)}
            self.wheels.append(self.vehicle | own)

    def of(self, wheel: int, entries: Sequence[Entry]) -> list[int]:
        """Columns of entries as a wheel sees them: the vehicle's and its own."""
        return [self.wheels[wheel][entry] for entry in entries]
