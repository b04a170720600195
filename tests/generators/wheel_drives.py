"""Drives as nodes on wheels record them, generated without the model under test.

Positions and rotations of a rigid wheel are computed in world axes at 1 kHz and differentiated numerically:
the rate from the change of the rotation, the specific force from the second difference of the sensing point's
position. Nothing is taken from hubodo. The sensor follows: mounting, scale, bias with warm-up, noise, its own
clock, saturation and steps of the LSM6DS33, by default at 2000 deg/s and 16 g (its 16-bit words end at 2293
deg/s).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.fft import next_fast_len
from scipy.spatial.transform import Rotation

from generators.noise import gyro_noise

RATE_HZ = 1000.0
GRAVITY = 9.80665
GYRO_STEP = np.radians(0.070)
ACCEL_STEP = 0.488e-3 * GRAVITY
GYRO_DENSITY = np.radians(7e-3)
ACCEL_DENSITY = 90e-6 * GRAVITY


@dataclass(frozen=True)
class Errors:
    """1 sigma of the errors drawn for each drive and node; all zero: perfect sensors on a flat road.

    radius, track: relative errors. scale, accel_scale: relative error of each gyro and accelerometer axis;
    scale_correlation: correlation of the scale errors of gx and gy with that of gz, as on the chips of a real
    car. bias, warmup: rad/s. tilt: tilt of the spin axis, rad. arm: lever arm in each direction, m.
    accel_bias: m/s². g_sensitivity: (rad/s)/(m/s²). clock: offset between the nodes, s. roll: roll rate of
    the moving vehicle, rad/s. vibration: m/s² per sample. road: error of the rolled distance, m per √m.
    noise: factor on the noise densities of the data sheet. bumps: roughness of the road in units of ISO 8608
    class A (16e-6 m³ at 0.1 cycles/m), filtered by a tyre of 10 Hz, which moves the hub up and down. flicker,
    accel_flicker: bias instability of every axis, rad/s and m/s² (IEEE 952's B).
    """

    radius: float = 0.002
    track: float = 0.005
    scale: float = 0.01
    accel_scale: float = 0.01
    bias: float = np.radians(1.0)
    warmup: float = np.radians(0.2)
    tilt: float = np.radians(1.0)
    arm: float = 0.01
    accel_bias: float = 0.2
    g_sensitivity: float = np.radians(1e-2) / GRAVITY
    clock: float = 0.003
    roll: float = 0.01
    vibration: float = 0.2
    road: float = 0.0005
    noise: float = 1.0
    bumps: float = 0.0
    flicker: float = 0.0
    accel_flicker: float = 0.0
    scale_correlation: float = 0.5


PERFECT = Errors(*([0.0] * 16))


@dataclass(frozen=True)
class Ends:
    """Ranges of the sensors, rad/s and m/s²: 2**15 counts."""

    gyro: float = 2**15 * GYRO_STEP
    accel: float = 2**15 * ACCEL_STEP


@dataclass(frozen=True)
class Node:
    """The record of a node and its true errors.

    t: (N,) s; gyro: (N, 3) rad/s; accel: (N, 3) m/s², node axes.
    """

    t: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    truth: dict[str, float]


@dataclass(frozen=True)
class WheelDrive:
    """A drive.

    nodes: records by node name. t, x, y, heading, speed: truth at 1 kHz. length: path, m. radius, track:
    declared values, m.
    """

    nodes: dict[str, Node]
    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    heading: np.ndarray
    speed: np.ndarray
    length: float
    radius: float
    track: float


@dataclass(frozen=True)
class Plan:
    """The planned motion of the vehicle.

    speed, yaw_rate: m/s along the road and rad/s at 1 kHz, smooth. slip: surface speed of a named wheel
    beyond the speed of the road under it, m/s. height: height of the road, m, equal under both wheels; None
    if level.
    """

    speed: np.ndarray
    yaw_rate: np.ndarray
    slip: dict[str, np.ndarray] = field(default_factory=dict)
    height: np.ndarray | None = None


def _smooth(value: np.ndarray, seconds: float = 0.3) -> np.ndarray:
    """Smooth by two passes of a raised cosine, by Fourier transform for speed."""
    width = int(seconds * RATE_HZ)
    kernel = np.hanning(2 * width + 3)
    size = next_fast_len(len(value) + 4 * width + 4, real=True)
    passed = np.fft.rfft(kernel / kernel.sum(), size)
    for _ in range(2):
        padded = np.pad(value, width + 1, mode="edge")
        whole = np.fft.irfft(np.fft.rfft(padded, size) * passed, size)
        value = whole[len(kernel) - 1 : len(padded)]
    return value


def legs(parts: list[tuple[float, float, float]]) -> Plan:
    """Return a plan of legs (duration s, speed m/s, yaw rate rad/s) with smooth transitions."""
    counts = [int(part[0] * RATE_HZ) for part in parts]
    speed = np.repeat([part[1] for part in parts], counts)
    yaw_rate = np.repeat([part[2] for part in parts], counts)
    return Plan(_smooth(speed), _smooth(yaw_rate))


def loop(
    rng: np.random.Generator,
    length: float = 250.0,
    standstill_s: float = 8.0,
    speed: tuple[float, float] = (0.8, 1.8),
) -> Plan:
    """Return a loop of `length` m with random legs, from rest to rest; speed: range of the legs, m/s."""
    parts, done = [(standstill_s, 0.0, 0.0)] if standstill_s > 0.0 else [], 0.0
    while done < length:
        duration, now = float(rng.uniform(3.0, 8.0)), float(rng.uniform(*speed))
        duration = min(duration, (length - done) / now + 0.5)
        turn = 2.0 * np.pi * now / length + float(rng.uniform(-0.3, 0.3))
        parts.append((duration, now, turn))
        done += duration * now
    parts.append((3.0, 0.0, 0.0))
    return legs(parts)


def ramps(parts: list[tuple[float, float, float]], hardest: float = 2.5, start_speed: float = 0.0) -> Plan:
    """Return a plan of legs (duration s, speed m/s, yaw rate rad/s), joined by ramps of `hardest` m/s².

    start_speed: speed before the first leg, m/s.
    """
    speeds, now = [], start_speed
    for duration, speed, _ in parts:
        speed_steps = np.minimum(
            hardest / RATE_HZ * np.arange(1, int(duration * RATE_HZ) + 1), abs(speed - now)
        )
        speeds.append(now + np.sign(speed - now) * speed_steps)
        now = float(speeds[-1][-1])
    counts = [len(leg) for leg in speeds]
    return Plan(_smooth(np.concatenate(speeds)), _smooth(np.repeat([part[2] for part in parts], counts)))


def drive(
    plan: Plan,
    rng: np.random.Generator,
    errors: Errors | None = None,
    radius: float = 0.15,
    track: float = 0.5,
    camber: float = 0.0,
    rate_hz: float = 104.0,
    facing: dict[str, str] | None = None,
    arm: tuple[float, float] | None = None,
    ends: Ends | None = None,
    latitude_deg: float | None = None,
    rotations: bool = False,
) -> WheelDrive:
    """Return the drive that follows a plan.

    facing: side to which the z axis of a node points, by name, `left` by default. arm: lever arm x, y, m,
    instead of a random one. ends: saturation limits of the sensors. latitude_deg: latitude on a rotating
    Earth (x east, y north); None for an Earth that does not rotate. rotations: True to tilt a node by a
    rotation instead of by the small vector that approximates it.
    """
    errors = errors or Errors()
    latitude = np.radians(latitude_deg or 0.0)
    earth = 0.0 if latitude_deg is None else 2.0 * np.pi / 86164.0905
    earth_rate = earth * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    dt = 1.0 / RATE_HZ
    t = np.arange(len(plan.speed)) * dt
    heading = _integral(plan.yaw_rate)
    height = np.zeros(len(t)) if plan.height is None else plan.height
    # A hub follows the height of the road: its wheel rolls along the slope, and the horizontal path is
    # shorter.
    level = np.sqrt(np.maximum(plan.speed**2 - (np.gradient(height) * RATE_HZ) ** 2, 0.0))
    level = np.copysign(level, plan.speed)
    x = _integral(level * np.cos(heading))
    y = _integral(level * np.sin(heading))
    true_track = track * (1.0 + errors.track * rng.standard_normal())
    roll = _wander(errors.roll, len(t), rng) * _smooth(np.minimum(1.0, np.abs(plan.speed) / 0.5))
    node_records = {}
    for name, side in (("left", 1.0), ("right", -1.0)):
        true_radius = radius * (1.0 + errors.radius * rng.standard_normal())
        slip = plan.slip.get(name, np.zeros(len(t)))
        rolled = plan.speed - plan.yaw_rate * side * 0.5 * true_track + slip
        jitter = errors.road * rng.standard_normal(len(t)) * np.sqrt(np.abs(rolled) * dt)
        theta = (
            rng.uniform(-np.pi, np.pi) + (_integral(rolled) + np.cumsum(_smooth(jitter, 0.05))) / true_radius
        )
        bumps = _bumps(errors.bumps, np.abs(rolled), rng)
        sensing = np.array(arm) if arm else errors.arm * rng.standard_normal(2)
        rate, force = _rigid_wheel(
            (x, y, height + bumps),
            *(heading, roll, theta, side, true_track, true_radius, camber, np.append(sensing, 0.0)),
            earth_rate,
        )
        turned = -1.0 if (facing or {}).get(name, "left") == "right" else 1.0
        flip = np.array([1.0, turned, turned])
        node = _sensor(t, rate * flip, force * flip, rng, errors, rate_hz, ends or Ends(), rotations)
        node.truth.update(
            radius=true_radius / radius - 1.0,
            track=true_track / track - 1.0,
            arm_x=float(sensing[0]),
            arm_y=float(sensing[1] * turned),
            start_angle=float(theta[0]),
        )
        node_records[name] = node
    return WheelDrive(
        node_records, t, x, y, heading, plan.speed, float(np.sum(np.abs(plan.speed)) * dt), radius, track
    )


def _integral(value: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (value[1:] + value[:-1]))]) / RATE_HZ


def _wander(rate: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return an angle near zero whose rate has the spread `rate` (second-order noise around 1 Hz)."""
    if rate == 0.0:
        return np.zeros(count)
    white = _smooth(rng.standard_normal(count), 0.25)
    return white * rate / np.std(np.gradient(white) * RATE_HZ)


def _bumps(roughness: float, speed: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the height of a hub, (N,) m: white slope through a tyre of 10 Hz with damping 0.4."""
    if roughness == 0.0:
        return np.zeros(len(speed))
    # Two-sided density of the slope: (2 pi 0.1)² 16e-6 / 2 per cycle/m; a metre of road takes 1/v seconds.
    density = 0.5 * (2.0 * np.pi * 0.1) ** 2 * 16e-6 * roughness
    climb = np.sqrt(density * speed * RATE_HZ) * rng.standard_normal(len(speed))
    frequency = 2.0 * np.pi * np.fft.rfftfreq(len(speed), 1.0 / RATE_HZ)
    own = 2.0 * np.pi * 10.0
    tyre = own**2 / (own**2 - frequency**2 + 2j * 0.4 * own * frequency)
    # Frequencies below 0.5 Hz are excluded: they are hills, not bumps.
    tyre[frequency < np.pi] = 0.0
    through = np.fft.irfft(np.fft.rfft(np.cumsum(climb) / RATE_HZ) * tyre, len(speed))
    return through * _smooth(np.minimum(1.0, speed / 0.5))


def _rigid_wheel(road, heading, roll, theta, side, track, radius, camber, arm, earth_rate):
    """Return rate and specific force, (N, 3) each, in node axes by differences of rotation and position.

    earth_rate: (3,) rad/s east, north, up.
    """
    zero, one = np.zeros_like(heading), np.ones_like(heading)
    ch, sh, cr, sr = np.cos(heading), np.sin(heading), np.cos(roll), np.sin(roll)
    # Rotations are (3, 3, N), because numpy is fastest along the last axis.
    world_from_body = np.array([[ch, -sh * cr, sh * sr], [sh, ch * cr, -ch * sr], [zero, sr, cr]])
    lean = side * camber
    up = np.array([[0.0], [-np.sin(lean)], [np.cos(lean)]])
    axle = np.array([[0.0], [np.cos(lean)], [np.sin(lean)]])
    forward = np.array([[1.0], [0.0], [0.0]])
    c, s = np.cos(theta), np.sin(theta)
    body_from_node = np.stack([c * up + s * forward, c * forward - s * up, one * axle], 1)
    world_from_node = np.einsum("ijn,jkn->ikn", world_from_body, body_from_node)
    hub_in_body = np.array([0.0, side * (0.5 * track - radius * np.sin(camber)), radius * np.cos(camber)])
    place = np.array(road) + np.einsum("ijn,j->in", world_from_body, hub_in_body)
    place += np.einsum("ijn,j->in", world_from_node, arm)
    dt = 1.0 / RATE_HZ
    change = np.gradient(world_from_node, dt, axis=2, edge_order=2)
    skew = np.einsum("jin,jkn->ikn", world_from_node, change)
    rate = 0.5 * np.array([skew[2, 1] - skew[1, 2], skew[0, 2] - skew[2, 0], skew[1, 0] - skew[0, 1]])
    rate += np.einsum("jin,j->in", world_from_node, earth_rate)
    acceleration = np.zeros_like(place)
    acceleration[:, 1:-1] = (place[:, 2:] - 2.0 * place[:, 1:-1] + place[:, :-2]) / dt**2
    acceleration[:, 0], acceleration[:, -1] = acceleration[:, 1], acceleration[:, -2]
    force = np.einsum("jin,jn->in", world_from_node, acceleration + np.array([[0.0], [0.0], [GRAVITY]]))
    return rate.T, force.T


def _sensor(t, rate, force, rng, errors, rate_hz, ends, rotations) -> Node:
    normal = rng.standard_normal
    turn = np.append(errors.tilt * normal(2), 0.0)
    if rotations:
        turned = Rotation.from_rotvec(turn).as_matrix()
        rate, force, longer = rate @ turned, force @ turned, turned[2, 2]
    else:
        # Axes tilted by the small vector m measure v - m x v, which is longer than v: a rotation would leave
        # gz less of the spin.
        rate, force = rate - np.cross(turn, rate), force - np.cross(turn, force)
        longer = np.sqrt(1.0 + turn @ turn)
    period = 1.0 / (rate_hz * (1.0 + 0.01 * rng.uniform(-1.0, 1.0))) if errors.noise else 1.0 / rate_hz
    sample_times = np.arange(t[0] + rng.uniform(0.0, period) * (errors.noise > 0), t[-1], period)
    late = errors.clock * normal()
    gyro_scale, accel_scale = errors.scale * normal(3), errors.accel_scale * normal(3)
    shared = errors.scale_correlation
    gyro_scale[:2] = shared * gyro_scale[2] + np.sqrt(1.0 - shared**2) * gyro_scale[:2]
    bias, warm, constant = errors.bias * normal(3), errors.warmup * normal(3), rng.uniform(60.0, 200.0)
    gravity_in_gyro = errors.g_sensitivity * normal((3, 3))
    at = np.stack([np.interp(sample_times, t, column) for column in np.hstack([rate, force]).T], 1)
    gyro, accel = at[:, :3], at[:, 3:]
    gyro = gyro * (1.0 + gyro_scale) + bias + warm * (1.0 - np.exp(-sample_times / constant))[:, None]
    gyro = gyro + accel @ gravity_in_gyro.T
    accel = accel * (1.0 + accel_scale) + errors.accel_bias * normal(3)
    bandwidth = np.sqrt(0.5 * rate_hz)
    for axes, size in ((gyro, errors.flicker), (accel, errors.accel_flicker)):
        for axis in range(3 if size else 0):
            axes[:, axis] += gyro_noise(len(sample_times), period, rng, b=size)
    gyro = gyro + errors.noise * GYRO_DENSITY * bandwidth * normal(gyro.shape)
    moving = np.interp(sample_times, t, np.abs(rate[:, 2])) > 0.1
    shake = np.where(moving, errors.vibration, 0.0)[:, None]
    accel = accel + (errors.noise * ACCEL_DENSITY * bandwidth + shake) * normal(accel.shape)
    gyro, accel = _words(gyro, ends.gyro), _words(accel, ends.accel)
    truth = {
        "spin_scale": float((1.0 + gyro_scale[2]) * longer - 1.0),
        "yaw_scale": float(0.5 * (gyro_scale[0] + gyro_scale[1])),
        "scale_difference": float(0.5 * (gyro_scale[0] - gyro_scale[1])),
        "bias_x": float(bias[0]),
        "bias_y": float(bias[1]),
        "bias_z": float(bias[2]),
        "tilt_x": float(turn[0]),
        "tilt_y": float(turn[1]),
        "late": float(late),
    }
    return Node(sample_times + late, gyro, accel, truth)


def _words(value: np.ndarray, end: float) -> np.ndarray:
    step = end / 2**15
    return np.round(np.clip(value / step, -32768, 32767)) * step


def with_slip(plan: Plan, node: str, start: float, duration: float, speed: float) -> Plan:
    """Return the plan with one wheel spinning `speed` m/s too fast from `start` for `duration` seconds."""
    t = np.arange(len(plan.speed)) / RATE_HZ
    return replace(plan, slip={node: _smooth(speed * ((t > start) & (t < start + duration)), 0.15)})
