"""What the wheel filter is told beforehand: geometry, noise, and what is known better than usual."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hubodo.calibration.file import CalibratedEffect, Calibration, Quantity
from hubodo.earth import vertical_earth_rate
from hubodo.effects.gyro import GyroBias
from hubodo.effects.wheel import WheelRadius
from hubodo.fuse.ranges import NodeRanges
from hubodo.fuse.wheel.entries import OF_VEHICLE, OF_WHEEL, Entry
from hubodo.fuse.wheel.stillness import RestLimits
from hubodo.vehicle import Facing, Side, Vehicle

_OF_ANOTHER_DAY = {GyroBias.name: 0.005, WheelRadius.name: 0.001}
"""1 sigma that what was calibrated has at least in another drive.

gyro_bias: rad/s, other temperatures and switchings on: 0.3 deg/s, what the LSM6DS33 drifts in six degrees
(0.05 deg/s/K, data sheet). wheel_radius: a fraction; pressure, load and wear, 0.3 mm on a car's wheel.
"""


@dataclass(frozen=True, slots=True)
class WheelNoise:
    """1 sigma of what is random from window to window.

    gyro: rad/s/sqrt(Hz), accel: m/s²/sqrt(Hz); data sheet of the LSM6DS33 (7 mdeg/s and 90 ug) with a margin
    for the quantization. The others are estimated, for an ordinary road at the speed of a wheelchair or a
    small robot. roll: rad/s of the vehicle about its forward axis. flex: (rad/s)/(m/s²), what vibration along
    the axle adds to the rates across it. push: m/s² of forward force that the wheel's own acceleration does
    not explain. vibration: the share of the axial accelerometer's spread that is added to it. sway: the same
    sideways, m/s². road, lateral: m per square root of a metre rolled, along the way and across it.
    """

    gyro: float = 1.3e-4
    accel: float = 2e-3
    roll: float = 0.02
    flex: float = 0.003
    push: float = 0.15
    vibration: float = 0.3
    sway: float = 0.3
    road: float = 0.002
    lateral: float = 0.001


@dataclass(frozen=True, slots=True)
class WheelNode:
    """A node on a wheel. known: what replaces the priors of its entries and the wheel's, facing left.

    gyro_limit: rad/s, accel_limit: m/s², where its channels clip: just below 2000 deg/s and 16 g, the ranges
    of the firmware, unless it is known better (`fuse/ranges.py`). steered: it goes its
    own way, and the track is that of its contact, with its heading.
    """

    side: Side
    facing: Facing
    known: Mapping[Entry, Quantity] = field(default_factory=dict)
    gyro_limit: float = 34.8
    accel_limit: float = 156.0
    steered: bool = False


@dataclass(frozen=True, slots=True)
class WheelConfig:
    """One or two wheels of a vehicle.

    radius, track_width: m. nodes: by name, one of each side at most. known: what replaces the priors of the
    vehicle's entries. start_heading: rad, heading_sigma: 1 sigma of it. told: whether it is told positions by
    somebody else; encoder: whether another odometer tells the wheels' surface speeds.
    ground_rate: rad/s by which the ground turns about up with the Earth.
    """

    radius: float
    track_width: float
    nodes: Mapping[str, WheelNode]
    noise: WheelNoise = field(default_factory=WheelNoise)
    rest: RestLimits = field(default_factory=RestLimits)
    known: Mapping[Entry, Quantity] = field(default_factory=dict)
    start_heading: float = 0.0
    heading_sigma: float = 0.0
    told: bool = False
    ground_rate: float = 0.0
    encoder: bool = False

    def __post_init__(self) -> None:
        sides = [node.side for node in self.nodes.values()]
        if not sides or len(set(sides)) != len(sides):
            raise ValueError(f"nodes sit on {sides}: one node on each wheel, one or two of them")


def wheel_config(
    vehicle: Vehicle,
    names: Mapping[str, object] | list[str],
    calibration: Calibration | None = None,
    ranges: Mapping[str, NodeRanges] | None = None,
) -> WheelConfig:
    """The filter's settings for those of a vehicle's nodes that sit on wheels and are among `names`.

    Steered wheels are left out where there are others; of steered ones alone the first is taken.

    calibration: replaces the priors of what it holds. ranges: by name, where known. Raises ValueError when no
    wheel node is left, or two sit on one wheel.
    """
    nodes: dict[str, WheelNode] = {}
    mounted = {name: mount for name, mount in vehicle.nodes.items() if name in names and mount.side}
    # A steered wheel shows its own way, not the vehicle's: it is used where there is no other, and alone.
    fixed = {name: mount for name, mount in mounted.items() if not mount.steered}
    for name, mount in (fixed or dict(list(mounted.items())[:1])).items():
        if mount.side is not None and mount.facing is not None:
            found = calibration.nodes.get(name) if calibration else None
            known = known_of(OF_WHEEL, found.effects if found else {}, mount.facing)
            limits = ranges[name].limits if ranges and name in ranges else {}
            nodes[name] = WheelNode(mount.side, mount.facing, known, steered=mount.steered, **limits)
    known = known_of(OF_VEHICLE, calibration.vehicle if calibration else {}, "left")
    ground_rate = 0.0 if vehicle.latitude_deg is None else vertical_earth_rate(vehicle.latitude_deg)
    return WheelConfig(vehicle.wheel_radius, vehicle.track_width, nodes, known=known, ground_rate=ground_rate)


def known_of(
    entries: tuple[Entry, ...], effects: Mapping[str, CalibratedEffect], facing: Facing
) -> dict[Entry, Quantity]:
    """What a calibration says of entries, as of a node that faces left, on another day."""
    known = {}
    for entry in entries:
        found = effects[entry.effect].parameters if entry.effect in effects else {}
        if entry.of is None or not entry.alone or not set(entry.parameters) <= set(found):
            continue
        share = entry.factor / len(entry.parameters)
        value = sum(found[name].value for name in entry.parameters) * share
        sigma = sum(found[name].sigma for name in entry.parameters) * share
        least = _OF_ANOTHER_DAY.get(entry.effect, 0.0)
        known[entry] = Quantity(entry.sign(facing) * value, max(sigma, least))
    return known
