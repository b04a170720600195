"""Entries of the state vector: parameters of effects and processes of the drive.

Prior, random walk and sign on a node facing right are declared by the effect, with their sources. The filter
transforms every node to face left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from hubodo.earth import STANDARD_GRAVITY
from hubodo.effects.accel import AccelBias, AccelNonorthogonality
from hubodo.effects.base import Effect
from hubodo.effects.gyro import COMMON_SCALE_SIGMA, GyroBias, GyroGSensitivity, GyroScaleFactor
from hubodo.effects.mounting import LeverArm, NodeMisalignment
from hubodo.effects.timing import TimeOffset
from hubodo.effects.vehicle import RoadGrade, TrackWidth
from hubodo.effects.wheel import WheelCamber, WheelRadius
from hubodo.vehicle import Facing

Scope = Literal["vehicle", "wheel"]


@dataclass(frozen=True, eq=False, slots=True)
class Entry:
    """One component of the state vector, of the vehicle or of each wheel with its node.

    Instances compare by identity, which makes dictionary lookups cheap.

    Attributes
    ----------
    scope : "vehicle" or "wheel".
    effect, parameter : names as in the model file; a process has names of its own.
    prior : 1 sigma before the first sample.
    random_walk : 1 sigma of the random walk, per √s.
    effect_class : class of the effect; None for a process.
    parameters : parameters of the effect whose mean this entry is, usually one.
    factor : factor from that mean to the state.
    is_single_effect : True if no other effect enters this entry, so that a calibration of the effect
    determines it.
    correlation_time : s of a first-order Gauss-Markov process whose stationary 1 sigma is the prior;
    infinite for a constant.
    is_integrated : True if the motion model integrates it over a window, from a rate.
    """

    scope: Scope
    effect: str
    parameter: str
    prior: float
    random_walk: float
    effect_class: type[Effect] | None = None
    parameters: tuple[str, ...] = ()
    factor: float = 1.0
    is_single_effect: bool = True
    correlation_time: float = math.inf
    is_integrated: bool = False

    @property
    def is_propagated(self) -> bool:
        """Return True if the motion model changes it within a window."""
        return self.is_integrated or math.isfinite(self.correlation_time)

    def __str__(self) -> str:
        return f"{self.effect}.{self.parameter}"

    def sign(self, facing: Facing) -> float:
        """Return -1.0 if a node facing right has the negated parameter of one facing left, else 1.0."""
        return (
            1.0 if self.effect_class is None else self.effect_class.facing_sign_of(self.parameters[0], facing)
        )

    @property
    def excitation(self) -> str:
        """Return the manoeuvre that makes this entry observable; empty if none is known."""
        estimate = None if self.effect_class is None else self.effect_class.odometry_prior(self.parameters[0])
        return "" if estimate is None else estimate.manoeuvre

    @property
    def is_learnable(self) -> bool:
        """Return True for a constant parameter of an effect, which a drive can estimate."""
        return self.effect_class is not None and self.correlation_time == math.inf


def _effect_entry(
    scope: Scope, effect: type[Effect], *parameters: str, factor: float = 1.0, alone: bool = True
) -> Entry:
    """Build an entry with the prior, random walk and correlation time declared by its effect."""
    estimate = effect.odometry_prior(parameters[0])
    assert estimate is not None, f"{effect.name}.{parameters[0]} is not estimated"
    prior, walk = estimate.sigma * factor, estimate.random_walk * factor
    named = " ".join(parameters)
    return Entry(
        scope, effect.name, named, prior, walk, effect, parameters, factor, alone, estimate.correlation_time
    )


X = Entry("vehicle", "motion", "x", 0.0, 0.0, is_integrated=True)
"""m; the track starts at the origin."""

Y = Entry("vehicle", "motion", "y", 0.0, 0.0, is_integrated=True)
"""m."""

HEADING = Entry("vehicle", "motion", "heading", 0.0, 0.0, is_integrated=True)
"""rad, unwrapped; the track starts at a given heading."""

SPEED = Entry("vehicle", "motion", "speed", 1.0, 0.0)
"""m/s; prior: walking pace. Its process noise per window is in `motion_prediction.py`."""

YAW_RATE = Entry("vehicle", "motion", "yaw_rate", 0.5, 0.0)
"""rad/s; prior: a brisk turn. Its process noise per window is in `motion_prediction.py`."""

TRACK_WIDTH = _effect_entry("vehicle", TrackWidth, "error")
TIME_OFFSET = _effect_entry("vehicle", TimeOffset, "delay")
"""s by which the time stamps of the second node are later than those of the first one."""

SLOPE = _effect_entry("vehicle", RoadGrade, "angle", factor=STANDARD_GRAVITY)
"""m/s², forward specific force caused by the slope of the road."""

WHEEL_ANGLE = Entry("wheel", "rolling", "angle", 0.3, 0.0, is_integrated=True)
"""rad, angle of the node's x axis from upright, initialised from gravity.

Prior: the vehicle may accelerate by a third of gravity meanwhile. The process noise is that of the gyro that
propagates the angle.
"""

GYRO_SCALE_Z = _effect_entry("wheel", GyroScaleFactor, "z")
GYRO_BIAS_Z = _effect_entry("wheel", GyroBias, "z")
GYRO_BIAS_X = _effect_entry("wheel", GyroBias, "x")
GYRO_BIAS_Y = _effect_entry("wheel", GyroBias, "y")
MISALIGNMENT_Y = _effect_entry("wheel", NodeMisalignment, "y")
MISALIGNMENT_X = _effect_entry("wheel", NodeMisalignment, "x")
LEVER_ARM_X = _effect_entry("wheel", LeverArm, "x")
LEVER_ARM_Y = _effect_entry("wheel", LeverArm, "y")
ACCEL_BIAS_X = _effect_entry("wheel", AccelBias, "x")
ACCEL_BIAS_Y = _effect_entry("wheel", AccelBias, "y")
ACCEL_BIAS_Z = _effect_entry("wheel", AccelBias, "z")
CAMBER = _effect_entry("wheel", WheelCamber, "angle")
GYRO_SCALE_ACROSS = _effect_entry("wheel", GyroScaleFactor, "x", "y")
GYRO_SCALE_COVARIANCE = COMMON_SCALE_SIGMA**2
"""Prior covariance of GYRO_SCALE_Z and GYRO_SCALE_ACROSS. Gravity shows the scale about the axle on every
metre, and through this covariance most of the scale across it, which the drive itself shows in turns only.
"""

GYRO_SCALE_DIFFERENCE = Entry("wheel", "gyro_across", "scale_difference", 0.0075, 2e-6)
"""Half of the scale error of gx minus that of gy; the prior belongs to scale errors of 1 % each.

On a slowly turning wheel each curve is measured by another mixture of the two gyros, so turns have errors
that no common scale explains. No calibration provides it, because a fast wheel shows only the mean of both.
Random walk: temperature, 0.012 % in an hour.
"""

YAW_RATE_FROM_GRAVITY = _effect_entry("wheel", GyroGSensitivity, "xx", "yy", factor=STANDARD_GRAVITY)
"""rad/s. Gravity rotates in the node, so the g-sensitivities of gx and gy add up to one constant yaw rate."""

WHEEL_RADIUS = _effect_entry("wheel", WheelRadius, "error")
AXIAL_LEAK_X = _effect_entry("wheel", AccelNonorthogonality, "zy", alone=False)
"""Share of the force along x in the reading of the axial accelerometer; a tilted node has the same effect."""

AXIAL_LEAK_Y = _effect_entry("wheel", AccelNonorthogonality, "zx", alone=False)
"""Negated share of the force along y in the reading of the axial accelerometer."""

RATE_BEYOND_RANGE = Entry("wheel", "clipping", "excess", 0.0, 0.0)
"""rad/s, rate about the axle beyond the range of a saturated gyro; zero while the gyro is in range."""

ANTENNA_X = Entry("vehicle", "antenna", "x", 1.5, 0.0)
"""m forward of the body origin, of the point whose position is measured; prior: anywhere on a car."""

ANTENNA_Y = Entry("vehicle", "antenna", "y", 0.5, 0.0)
"""m to the left; most antennas are near the middle."""

POSITION_DELAY = Entry("vehicle", "positions", "delay", 0.05, 0.0)
"""s by which time stamps of positions are later than those of the nodes; prior: two clocks set by hand."""

POSITION_ERROR_X = Entry("vehicle", "positions", "error_x", 0.1, 0.0, correlation_time=600.0)
"""m east, the slowly varying error of positions: satellite geometry, multipath, filtering in the receiver.

Correlation time: ten minutes, in which the satellites move on; errors after a jump last as long. The prior
is replaced by a size estimated from the positions.
"""

POSITION_ERROR_Y = Entry("vehicle", "positions", "error_y", 0.1, 0.0, correlation_time=600.0)
"""m north."""

ENCODER_LEFT = Entry("vehicle", "encoder", "left", 0.01, 0.0)
"""Relative scale error of the surface speed that another odometer reports of the left wheel: its radius."""

ENCODER_RIGHT = Entry("vehicle", "encoder", "right", 0.01, 0.0)

VEHICLE_ENTRIES = (X, Y, HEADING, SPEED, YAW_RATE, TRACK_WIDTH, TIME_OFFSET, SLOPE)
WHEEL_ENTRIES = (
    WHEEL_ANGLE,
    *(GYRO_SCALE_Z, GYRO_BIAS_Z, GYRO_BIAS_X, GYRO_BIAS_Y, MISALIGNMENT_Y, MISALIGNMENT_X),
    *(LEVER_ARM_X, LEVER_ARM_Y, ACCEL_BIAS_X, ACCEL_BIAS_Y, ACCEL_BIAS_Z, CAMBER, GYRO_SCALE_ACROSS),
    *(
        GYRO_SCALE_DIFFERENCE,
        YAW_RATE_FROM_GRAVITY,
        WHEEL_RADIUS,
        AXIAL_LEAK_X,
        AXIAL_LEAK_Y,
        RATE_BEYOND_RANGE,
    ),
)
POSITION_ENTRIES = (ANTENNA_X, ANTENNA_Y, POSITION_DELAY, POSITION_ERROR_X, POSITION_ERROR_Y)
"""Additional entries of a filter aided by positions."""

ENCODER_ENTRIES = (ENCODER_LEFT, ENCODER_RIGHT)
"""Additional entries of a filter aided by surface speeds of another odometer."""

OBSERVABLE_WHEN_ROLLING = (
    *(GYRO_SCALE_Z, MISALIGNMENT_X, MISALIGNMENT_Y),
    *(LEVER_ARM_X, LEVER_ARM_Y, WHEEL_RADIUS, TIME_OFFSET),
)
"""Entries that multiply the rate of a wheel. At standstill that rate is gyro noise, so they are not
observable.
"""

OBSERVABLE_WHEN_TURNING = (GYRO_SCALE_ACROSS, GYRO_SCALE_DIFFERENCE, TRACK_WIDTH)
"""Entries that multiply the yaw rate of the vehicle."""

OBSERVABLE_WITH_TWO_WHEELS = (TRACK_WIDTH, TIME_OFFSET)
"""Entries that a single wheel cannot observe."""


class StateLayout:
    """Column of each entry in the state.

    First all entries that the motion model propagates, so that their rows are one slice, then all others; in
    both parts those of the vehicle before those of each wheel.

    Attributes
    ----------
    n_propagated : number of entries that the motion model propagates.
    vehicle : columns of the vehicle's entries.
    wheels : for each wheel, columns of its own entries and of the vehicle's.
    size : length of the state vector.
    """

    def __init__(self, wheels: int, position_aided: bool = False, encoder_aided: bool = False) -> None:
        of_vehicle = (
            VEHICLE_ENTRIES
            + (POSITION_ENTRIES if position_aided else ())
            + (ENCODER_ENTRIES if encoder_aided else ())
        )
        owners: list[tuple[int | None, Entry]] = [(None, entry) for entry in of_vehicle]
        owners += [(wheel, entry) for wheel in range(wheels) for entry in WHEEL_ENTRIES]
        self.vehicle: dict[Entry, int] = {}
        of_wheels: list[dict[Entry, int]] = [{} for _ in range(wheels)]
        for column, (owner, entry) in enumerate(sorted(owners, key=lambda it: not it[1].is_propagated)):
            (self.vehicle if owner is None else of_wheels[owner])[entry] = column
        self.wheels = [self.vehicle | own for own in of_wheels]
        self.size = len(owners)
        self.n_propagated = sum(entry.is_propagated for _, entry in owners)

    def columns_of(self, wheel: int, entries: Sequence[Entry]) -> list[int]:
        """Return the columns of `entries` for a wheel, its own and the vehicle's."""
        return [self.wheels[wheel][entry] for entry in entries]
