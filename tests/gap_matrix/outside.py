"""Eight effects outside the vocabulary, each with the channels and the quantity that show it.

All are added to what a node feels, before its noise; one node of the two has it. What is linear is dosed like
any other effect (`dose.Meter`); bit errors are counted, since a single one is worth thousands of nats.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gap_matrix import cases, sensor
from gap_matrix.cases import Setup
from gap_matrix.dose import MEDIUM, STRONG, Meter
from gap_matrix.effects import SIDES
from gap_matrix.sensor import ACCEL_LSB, GYRO_LSB
from gap_matrix.world import Array, Channels, slope

CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")
LSB = (GYRO_LSB,) * 3 + (ACCEL_LSB,) * 3
BIT_ERRORS = {"medium": 10, "strong": 40}
NATS = {"medium": MEDIUM, "strong": STRONG}
# A channel that has at least this share of the strongest one's energy is one that shows it.
_SHOWS = 0.2


@dataclass(frozen=True)
class Outsider:
    """A hidden effect outside the vocabulary: its kind, node and size.

    added: (n, 6). channels: `left.gx` and so on, where it shows. words: of which one should stand in a
        description of what it depends on.
    """

    name: str
    node: str
    size: float
    gain: float
    added: Array
    channels: tuple[str, ...]
    words: tuple[str, ...]


Draw = Callable[[np.random.Generator, Setup, Channels, Array], Array]


@dataclass(frozen=True)
class _Kind:
    draw: Draw  # (n, 6) at a usual size
    words: tuple[str, ...]


def hide(setup: Setup, name: str, strength: str, meter: Meter | None = None) -> Outsider:
    """Return the effect drawn by this seed, medium or strong.

    Raises KeyError if the name is not one of KINDS.
    """
    kind = KINDS[name]
    rng = np.random.default_rng((setup.seed, 8, *name.encode()))
    node = str(rng.choice(SIDES))
    felt = cases.channels(setup, node, setup.known)
    meter = meter or Meter(setup)
    taken = setup.taken[node]
    if name == "bit_error":
        added, size = _bit_errors(rng, setup, node, felt, BIT_ERRORS[strength]), float(BIT_ERRORS[strength])
    else:
        unit = kind.draw(rng, setup, felt, taken)
        size = float(np.sqrt(NATS[strength] / meter.gain_of(node, unit)))
        added = size * unit
    energy = meter.energy(node, added)
    shown = tuple(f"{node}.{CHANNELS[k]}" for k in np.flatnonzero(energy >= _SHOWS * energy.max()))
    return Outsider(name, node, size, meter.gain_of(node, added), added, shown, kind.words)


def records(setup: Setup, outsider: Outsider) -> dict[str, sensor.Record]:
    """Return the records of both nodes."""
    return {
        node: cases.record(setup, node, [], outsider.added if node == outsider.node else 0.0)
        for node in SIDES
    }


def _flat_spot(rng, setup, felt, taken):
    """A kick upwards whenever one place of the tyre is below, growing as the square of the speed."""
    speed, c, s = _at(felt, taken, felt.motion.speed, np.cos(felt.angle), np.sin(felt.angle))
    place = rng.uniform(-np.pi, np.pi)
    off = np.arctan2(s * np.cos(place) - c * np.sin(place), c * np.cos(place) + s * np.sin(place))
    kick = (speed / 3.0) ** 2 * np.exp(-0.5 * (off / 0.12) ** 2)
    facing = _facing(felt)
    return _six(ax=kick * c, ay=-facing * kick * s)


def _loose_mount(rng, setup, felt, taken):
    """The node tips to the other end of its play, across the axle, when the torque turns round."""
    pull = slope(felt.motion.speed, felt.motion.step)
    side, flips = 1.0, np.empty(len(pull))
    for k, a in enumerate(pull.tolist()):
        if a * side < -0.3:
            side = -side
        flips[k] = side
    tip = 1e-3 * sensor.one_pole(flips[None], 0.03, felt.motion.step)[0]
    heading = rng.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(heading), np.sin(heading), 0.0])
    rate = slope(tip, felt.motion.step) * axis[:, None] - tip * np.cross(axis, felt.rate, axisb=0).T
    force = -tip * np.cross(axis, felt.force, axisb=0).T
    return sensor.sampled(np.vstack([rate, force]), felt.motion.step, taken).T


def _rectified_vibration(rng, setup, felt, taken):
    """Shaking, which grows with the speed, shifts the gyro's zero as its square."""
    (speed,) = _at(felt, taken, felt.motion.speed)
    return _gyro(rng, 1e-3 * speed**2)


def _supply_step(rng, setup, felt, taken):
    """The supply drops at some moment and the gyro's zero with it, for good."""
    at = rng.uniform(0.3, 0.7) * taken[-1]
    return _gyro(rng, 1e-3 * (taken > at))


def _motor_tone(rng, setup, felt, taken):
    """A machine on the frame that runs at its own speed, felt by one axis of the accelerometer."""
    tone = 0.05 * np.sin(2.0 * np.pi * rng.uniform(6.0, 40.0) * taken + rng.uniform(-np.pi, np.pi))
    return _six(**{str(rng.choice(["ax", "ay", "az"])): tone})


def _temperature_gradient(rng, setup, felt, taken):
    """The gyro's zero moves while the temperature changes, not with the temperature."""
    (pace,) = _at(felt, taken, slope(setup.drive.temperature, felt.motion.step))
    return _gyro(rng, 0.05 * pace)


def _magnet(rng, setup, felt, taken):
    """A magnet on the frame that the node passes once per revolution, in one gyro axis across the axle.

    Along the axle the gyro's answer to gravity would look the same: that one is in the vocabulary.
    """
    angle = rng.uniform(-np.pi, np.pi)
    (once,) = _at(felt, taken, np.cos(felt.angle - angle))
    return _six(**{str(rng.choice(["gx", "gy"])): 1e-3 * once})


def _bit_errors(rng, setup: Setup, node: str, felt: Channels, count: int) -> Array:
    """A bit of the high byte of one axis is read wrong, at random moments."""
    axis, bit = int(rng.integers(6)), int(rng.integers(8, 12))
    clean = sensor.clean(felt, {}, setup.taken[node], setup.drive.temperature)[:, axis]
    hit = rng.permutation(len(clean))[:count]
    is_set = np.round(clean[hit] / LSB[axis]).astype(int) >> bit & 1
    added = np.zeros((len(clean), 6))
    added[hit, axis] = np.where(is_set, -1.0, 1.0) * 2.0**bit * LSB[axis]
    return added


def _no_draw(rng, setup, felt, taken):
    raise TypeError("bit errors are counted, not drawn at a size")


KINDS: Mapping[str, _Kind] = {
    "tyre_flat_spot": _Kind(_flat_spot, ("revolution", "theta", "wheel angle", "impulse", "pulse")),
    "loose_mount": _Kind(
        _loose_mount, ("torque", "accelerat", "brak", "changes", "hysteresis", "backlash", "loose", "step")
    ),
    "vibration_rectification": _Kind(_rectified_vibration, ("speed", "spin", "vibration")),
    "supply_step": _Kind(_supply_step, ("step", "jump", "switch", "steps")),
    "bit_error": _Kind(_no_draw, ("bit", "jump", "outlier", "spike", "single samples", "few samples")),
    "motor_tone": _Kind(_motor_tone, ("tone", "hz", "frequency", "periodic", "sine")),
    "temperature_gradient": _Kind(_temperature_gradient, ("temperature", "warm", "heat")),
    "magnet": _Kind(_magnet, ("revolution", "theta", "wheel angle")),
}


def _at(felt: Channels, taken: Array, *rows: Array) -> Array:
    return sensor.sampled(np.vstack(rows), felt.motion.step, taken)


def _six(**channels: Array) -> Array:
    first = next(iter(channels.values()))
    return np.stack([channels.get(name, np.zeros(len(first))) for name in CHANNELS], 1)


def _gyro(rng, shape: Array) -> Array:
    """Return the shape in a random direction of the three gyro axes."""
    direction = rng.standard_normal(3)
    return np.outer(shape, [*(direction / np.linalg.norm(direction)), 0.0, 0.0, 0.0])


def _facing(felt: Channels) -> float:
    """Return +1 where the z axis points left, read off gravity: f_y = -facing g sin(angle)."""
    return float(-np.sign(np.sum(felt.force[1] * np.sin(felt.angle))))
