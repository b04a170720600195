"""Settings of the wheel filter: geometry, noise densities, and priors from calibrations and from nodes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from hubodo.calibration.file import CalibratedEffect, Calibration, Quantity
from hubodo.earth import UNKNOWN_PLACE_EARTH_RATE_SIGMA, vertical_earth_rate
from hubodo.effects.gyro import GyroBias
from hubodo.effects.triad import XYZ
from hubodo.effects.wheel import WheelRadius
from hubodo.fuse.ranges import NodeRanges
from hubodo.fuse.wheel.entries import VEHICLE_ENTRIES, WHEEL_ENTRIES, WHEEL_RADIUS, Entry
from hubodo.fuse.wheel.motion_state import StandstillLimits
from hubodo.recording import Recording, Table
from hubodo.vehicle import Facing, RadiusSource, Side, Vehicle
from hubowire.messages import FilterState


@dataclass(frozen=True, slots=True)
class RadiusSigmas:
    """Prior 1 sigma of wheel radii, as fractions: the part that all wheels share, and the part of each.

    Tyres of one kind, measured in one way, share an error; pressure, load and wear make them unequal.
    """

    common: float
    own: float

    @property
    def total(self) -> float:
        """Return the 1 sigma of the radius of one wheel."""
        return math.hypot(self.common, self.own)


RADIUS_SIGMAS: Mapping[RadiusSource, RadiusSigmas] = {
    "rolled": RadiusSigmas(0.0025, 0.0017),
    "tape": RadiusSigmas(0.009, 0.004),
    "nominal": RadiusSigmas(0.025, 0.004),
}
"""Prior 1 sigma of the radii by how they were determined: in all 0.3, 1 and 2.5 %.

rolled: ten metres or more rolled in a straight line, with turns counted. tape: around or up to the axle of a
tyre, which deflects under load. nominal: the size on a tyre or in a data sheet; the tyres of a real car of
nominally 0.300 m roll 2.6 % less.
"""

_MIN_CALIBRATION_SIGMA = {GyroBias.name: 0.005, WheelRadius.name: 0.001}
"""Smallest 1 sigma of a calibrated parameter on another drive.

gyro_bias: rad/s; 0.3 deg/s is the drift of an LSM6DS33 over six degrees Celsius (0.05 deg/s/K, data sheet).
wheel_radius: fraction; tyre pressure, load and wear change a car wheel by 0.3 mm.
"""


@dataclass(frozen=True, slots=True)
class WheelNoise:
    """Standard deviations (1 sigma) of the noise of one window.

    The two white-noise densities are those of the LSM6DS33 data sheet (7 mdeg/s/√Hz and 90 µg/√Hz) with a
    margin for quantisation. The others are estimated for an ordinary road at the speed of a wheelchair or a
    small robot.

    Attributes
    ----------
    gyro : rad/s/√Hz, white noise of the gyros.
    accel : m/s²/√Hz, white noise of the accelerometers.
    roll_rate : rad/s, roll rate of the vehicle about its forward axis.
    axle_flex : (rad/s)/(m/s²), rate across the axle per unit of axial vibration.
    forward_force : m/s², forward specific force that the wheel's own acceleration does not explain.
    vibration_share : fraction of the standard deviation of the axial accelerometer that counts as force
        noise.
    lateral_force : m/s², unmodelled specific force along the axle.
    road_roughness : m/√m, along the path.
    lateral_slip : m/√m, across the path.
    """

    gyro: float = 1.3e-4
    accel: float = 2e-3
    roll_rate: float = 0.02
    axle_flex: float = 0.003
    forward_force: float = 0.15
    vibration_share: float = 0.3
    lateral_force: float = 0.3
    road_roughness: float = 0.002
    lateral_slip: float = 0.001


@dataclass(frozen=True, slots=True)
class WheelNode:
    """Settings of one node on a wheel.

    Attributes
    ----------
    side, facing : side of the vehicle, and direction of the node's z axis.
    priors : calibrated values that replace the default priors of the node and its wheel, as for a node
    facing left.
    gyro_limit, accel_limit : rad/s and m/s² at which channels saturate; the defaults are just below 2000
    deg/s and 16 g, the ranges of the firmware; `fuse/ranges.py` determines those of a log.
    steered : True if the wheel steers; the track is then that of its contact point, and the heading its own.
    """

    side: Side
    facing: Facing
    priors: Mapping[Entry, Quantity] = field(default_factory=dict)
    gyro_limit: float = 34.8
    accel_limit: float = 156.0
    steered: bool = False


@dataclass(frozen=True, slots=True)
class WheelConfig:
    """Settings of the filter for one or two wheels of a vehicle.

    Attributes
    ----------
    radius, track_width : m.
    nodes : settings by node name; one node on each side at most.
    priors : calibrated values that replace the default priors of the vehicle's entries.
    start_heading, heading_sigma : rad, initial heading and its 1 sigma.
    position_aided : True if positions are processed as measurements; adds the states of `POSITION_ENTRIES`.
    ground_rate : rad/s, rotation of the ground about the vertical with the Earth.
    ground_rate_sigma : rad/s, its 1 sigma, of an unknown latitude.
    encoder_aided : True if another odometer reports surface speeds; adds the states of `ENCODER_ENTRIES`.
    radius_sigmas : prior 1 sigma of the radii of wheels that are not calibrated.
    """

    radius: float
    track_width: float
    nodes: Mapping[str, WheelNode]
    noise: WheelNoise = field(default_factory=WheelNoise)
    standstill_limits: StandstillLimits = field(default_factory=StandstillLimits)
    priors: Mapping[Entry, Quantity] = field(default_factory=dict)
    start_heading: float = 0.0
    heading_sigma: float = 0.0
    position_aided: bool = False
    ground_rate: float = 0.0
    ground_rate_sigma: float = 0.0
    encoder_aided: bool = False
    radius_sigmas: RadiusSigmas = RadiusSigmas(0.0, WHEEL_RADIUS.prior)

    @property
    def common_radius_sigma(self) -> float:
        """Return the 1 sigma of the relative radius error that all wheels share; 0 after a calibration."""
        is_calibrated = any(WHEEL_RADIUS in node.priors for node in self.nodes.values())
        return 0.0 if is_calibrated else self.radius_sigmas.common

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
    """Return the filter settings for the wheel nodes of a vehicle that are among `names`.

    Steered wheels are left out if there are others; of steered wheels alone the first one is used.
    `calibration` replaces the priors of the parameters it holds. `ranges` holds saturation limits by node
    name. Raise ValueError if no wheel node is left or two of them sit on one wheel.
    """
    nodes: dict[str, WheelNode] = {}
    mounted = {name: mount for name, mount in vehicle.nodes.items() if name in names and mount.side}
    # A steered wheel follows its own path, not the vehicle's, so it is used only if there is no other one.
    fixed = {name: mount for name, mount in mounted.items() if not mount.steered}
    for name, mount in (fixed or dict(list(mounted.items())[:1])).items():
        if mount.side is not None and mount.facing is not None:
            parameters = calibration.nodes.get(name) if calibration else None
            known = priors_from_calibration(
                WHEEL_ENTRIES, parameters.effects if parameters else {}, mount.facing
            )
            limits = ranges[name].clipping_limits if ranges and name in ranges else {}
            nodes[name] = WheelNode(mount.side, mount.facing, known, steered=mount.steered, **limits)
    known = priors_from_calibration(VEHICLE_ENTRIES, calibration.vehicle if calibration else {}, "left")
    ground_rate, ground_rate_sigma = 0.0, UNKNOWN_PLACE_EARTH_RATE_SIGMA
    if vehicle.latitude_deg is not None:
        ground_rate, ground_rate_sigma = vertical_earth_rate(vehicle.latitude_deg), 0.0
    return WheelConfig(
        vehicle.wheel_radius,
        vehicle.track_width,
        nodes,
        priors=known,
        ground_rate=ground_rate,
        ground_rate_sigma=ground_rate_sigma,
        radius_sigmas=RADIUS_SIGMAS[vehicle.radius_from],
    )


def priors_from_calibration(
    entries: tuple[Entry, ...], effects: Mapping[str, CalibratedEffect], facing: Facing
) -> dict[Entry, Quantity]:
    """Return priors for `entries` from calibrated effects, with the sign of a node facing left.

    Sigmas are raised to the change that is possible between two drives.
    """
    known = {}
    for entry in entries:
        parameters = effects[entry.effect].parameters if entry.effect in effects else {}
        if (
            entry.effect_class is None
            or not entry.is_single_effect
            or not set(entry.parameters) <= set(parameters)
        ):
            continue
        share = entry.factor / len(entry.parameters)
        value = sum(parameters[name].value for name in entry.parameters) * share
        sigma = sum(parameters[name].sigma for name in entry.parameters) * share
        least = _MIN_CALIBRATION_SIGMA.get(entry.effect, 0.0)
        known[entry] = Quantity(entry.sign(facing) * value, max(sigma, least))
    return known


def add_node_biases(
    calibration: Calibration | None, recording: Recording, names: Iterable[str]
) -> tuple[Calibration | None, tuple[str, ...]]:
    """Return the calibration with the bias last reported by each node, and these nodes' names.

    A bias in the calibration takes precedence. `priors_from_calibration` raises the sigma to its minimum for
    another temperature and another day, and uses that minimum where the node does not know its sigma.
    """
    reporting_nodes = []
    for name in names:
        node = calibration.nodes.get(name) if calibration is not None else None
        table = recording.bias_filters.get(name)
        if table is None or (node is not None and GyroBias.name in node.effects):
            continue
        effect = _read_last_bias(table)
        if effect is not None:
            calibration = (calibration or Calibration()).with_node(name, {GyroBias.name: effect})
            reporting_nodes.append(name)
    return calibration, tuple(reporting_nodes)


def _read_last_bias(table: Table) -> CalibratedEffect | None:
    """Return the bias in the last row in which the firmware was tracking, None without such a row."""
    is_tracking = table["state"] == FilterState.TRACKING
    if not is_tracking.any():
        return None
    parameters = {}
    for axis in XYZ:
        bias, sigma = (float(table[f"{what}_{axis}"][is_tracking][-1]) for what in ("bias", "sigma"))
        parameters[axis] = Quantity(bias, 0.0 if math.isnan(sigma) else sigma)
    return CalibratedEffect(parameters, method="bias filter of the node")
