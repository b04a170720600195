"""What the wheel filter is told beforehand: geometry, sensor noise, and how well each error is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from hubodo.calibration.file import Calibration, NodeCalibration, Quantity
from hubodo.fuse.wheel import phase
from hubodo.fuse.wheel.zero_velocity import RestLimits
from hubodo.vehicle import Facing, Side, Vehicle, facing_sign

# rad/s; a calibrated bias is worth that much after other temperatures and switchings on.
_BIAS_OF_ANOTHER_DAY = 0.005


@dataclass(frozen=True, slots=True)
class WheelPrior:
    """One sigma before the first sample, and per square root of a second of wandering, of a wheel's states.

    spin_scale, yaw_scale (the mean of two axes of 1 % each), radius: fractions. biases: rad/s. tilt,
    camber: rad. arm: m. force: m/s². yaw_bias: rad/s that gravity makes in a gyro (its g-sensitivity times
    g).
    """

    spin_scale: float = 0.015
    bias: float = 0.1
    tilt: float = 0.03
    arm: float = 0.1
    force: float = 0.4
    camber: float = 0.05
    yaw_scale: float = 0.0075
    yaw_bias: float = 1.2e-4
    radius: float = 0.004
    bias_walk: float = 1e-4
    scale_walk: float = 2e-6
    force_walk: float = 1e-3
    radius_walk: float = 2e-5


@dataclass(frozen=True, slots=True)
class WheelNoise:
    """1 sigma of what is random from window to window.

    gyro: rad/s/sqrt(Hz). accel: m/s²/sqrt(Hz). roll: rad/s of the vehicle about its forward axis. push: m/s²
    of forward force that the wheel's own acceleration does not explain; flex: (rad/s)/(m/s²), what vibration
    along the axle adds to the rates across it. vibration: the share of the axial
    accelerometer's spread that is added to it. sway: the same sideways, m/s². road, lateral: m per square
    root of a metre rolled. slope: m/s² of road slope, which changes over `slope_time` s.
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
    slope: float = 0.15
    slope_time: float = 10.0


@dataclass(frozen=True, slots=True)
class WheelNode:
    """A node on a wheel. known: state number of `phase` -> what a calibration says of it, facing left."""

    side: Side
    facing: Facing
    prior: WheelPrior = field(default_factory=WheelPrior)
    known: Mapping[int, Quantity] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class WheelConfig:
    """One or two wheels of a vehicle.

    radius, track_width: m. nodes: by name, one of each side at most. track: 1 sigma of the track as a
    fraction; clock: s between the clocks of two nodes. gyro_limit: rad/s, accel_limit: m/s², where the
    channels clip. start_heading: rad, heading_sigma: 1 sigma of it.
    """

    radius: float
    track_width: float
    nodes: Mapping[str, WheelNode]
    noise: WheelNoise = field(default_factory=WheelNoise)
    rest: RestLimits = field(default_factory=RestLimits)
    track_error: float = 0.0
    track_sigma: float = 0.005
    clock_sigma: float = 0.01
    gyro_limit: float = 34.8
    accel_limit: float = 156.0
    start_heading: float = 0.0
    heading_sigma: float = 0.0

    def __post_init__(self) -> None:
        sides = [node.side for node in self.nodes.values()]
        if not sides or len(set(sides)) != len(sides):
            raise ValueError(f"nodes sit on {sides}: one node on each wheel, one or two of them")


def wheel_config(
    vehicle: Vehicle, names: Mapping[str, object] | list[str], calibration: Calibration | None = None
) -> WheelConfig:
    """The filter's settings for those of a vehicle's nodes that sit on wheels and are among `names`.

    calibration: replaces the priors of what it holds. Raises ValueError when no wheel node is left, or two
    sit on one wheel.
    """
    nodes = {}
    for name, mount in vehicle.nodes.items():
        if name in names and mount.side is not None and mount.facing is not None:
            known = calibration.nodes.get(name) if calibration else None
            nodes[name] = WheelNode(mount.side, mount.facing, known=_known(known, mount.facing))
    config = WheelConfig(vehicle.wheel_radius, vehicle.track_width, nodes)
    track = calibration.vehicle.get("track_width") if calibration else None
    if track is not None and "error" in track.parameters:
        error = track.parameters["error"]
        config = replace(config, track_error=error.value, track_sigma=error.sigma)
    return config


def _known(node: NodeCalibration | None, facing: Facing) -> dict[int, Quantity]:
    """Effects of a calibration as states of a node that faces left: a node facing right has y and z negated.

    A mounting turned by the small vector m makes Omega read Omega - m x Omega: gx gains -m_y, gy gains m_x
    per unit of spin.
    """
    if node is None:
        return {}
    sign = facing_sign(facing)
    table = (
        ("gyro_scale_factor", "z", phase.SPIN_SCALE, 1.0),
        ("gyro_bias", "z", phase.SPIN_BIAS, sign),
        ("gyro_bias", "x", phase.BIAS_X, 1.0),
        ("gyro_bias", "y", phase.BIAS_Y, sign),
        ("node_misalignment", "y", phase.TILT_X, -sign),
        ("node_misalignment", "x", phase.TILT_Y, 1.0),
        ("lever_arm", "x", phase.ARM_X, 1.0),
        ("lever_arm", "y", phase.ARM_Y, sign),
        ("accel_bias", "x", phase.FORCE_X, 1.0),
        ("accel_bias", "y", phase.FORCE_Y, sign),
        ("accel_bias", "z", phase.FORCE_Z, sign),
        ("wheel_radius", "error", phase.RADIUS, 1.0),
    )
    found = {}
    for effect, parameter, state, factor in table:
        if effect in node.effects and parameter in node.effects[effect].parameters:
            quantity = node.effects[effect].parameters[parameter]
            least = _BIAS_OF_ANOTHER_DAY if effect == "gyro_bias" else 0.0
            found[state] = Quantity(factor * quantity.value, max(quantity.sigma, least))
    scale = node.effects.get("gyro_scale_factor")
    if scale is not None and {"x", "y"} <= set(scale.parameters):
        x, y = scale.parameters["x"], scale.parameters["y"]
        found[phase.YAW_SCALE] = Quantity(0.5 * (x.value + y.value), 0.5 * (x.sigma + y.sigma))
    return found
