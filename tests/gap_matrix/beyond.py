"""Kinds of effect outside the vocabulary: what each adds to the readings, and its true formula.

Each is added to what a node feels, before its noise, and dosed like any other effect; the slipping clock is
in the stamps instead. `truth` is by the names that the parameters of a scaffolded effect can have: what leans
to the left is az on a node facing left, and its opposite on one facing right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gap_matrix import cases, sensor
from gap_matrix.cases import Setup
from gap_matrix.dose import Meter
from gap_matrix.effects import SIDES
from gap_matrix.world import Array, Channels, integral, slope

CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")
SLIP = 0.004  # s


@dataclass(frozen=True)
class Beyond:
    """What is hidden. node: the one that has it, or all. truth: of the parameters that tell it."""

    name: str
    node: str
    records: Mapping[str, sensor.Record]
    truth: Mapping[str, float]


@dataclass(frozen=True)
class Unit:
    """One size of it. added: (n, 6). truth: amplitudes, of a unit; places: what does not grow with it."""

    added: Array
    truth: Mapping[str, float]
    places: Mapping[str, float]


Draw = Callable[[np.random.Generator, Setup, Channels, Array], Unit]


def hide(setup: Setup, name: str, nats: float) -> Beyond:
    """Return the kind as drawn by this seed, scaled to a gain in nats. Raises KeyError for another name."""
    rng = np.random.default_rng((setup.seed, 9, *name.encode()))
    node = str(rng.choice(SIDES))
    if name == "slipping_clock":
        return _slipping_clock(rng, setup, node)
    meter, kind = Meter(setup), KINDS[name]
    nodes = SIDES if name in SHARED else (node,)
    state = rng.bit_generator.state
    units = {}
    for one in nodes:
        rng.bit_generator.state = state
        units[one] = kind(rng, setup, cases.channels(setup, one, setup.known), setup.taken[one])
    size = float(np.sqrt(nats / sum(meter.gain_of(one, unit.added) for one, unit in units.items())))
    made = {
        one: cases.record(setup, one, [], size * units[one].added if one in units else 0.0) for one in SIDES
    }
    unit = units[nodes[0]]
    truth = {key: size * value for key, value in unit.truth.items()} | dict(unit.places)
    return Beyond(name, "all" if len(nodes) > 1 else node, made, truth)


def _steered_wheel(rng, setup, felt, taken) -> Unit:
    """The wheel turns about the vertical with the bend of the path, v r / (v² + 1/4), and its node too."""
    speed, turning = felt.motion.speed, felt.motion.yaw_rate
    rate = slope(speed * turning / (speed**2 + 0.25), felt.motion.step)
    rate, c, s = _at(felt, taken, rate, np.cos(felt.angle), np.sin(felt.angle))
    return Unit(_six(gx=rate * c, gy=-_facing(felt) * rate * s), {"yaw": 1.0}, {})


def _unbalanced_wheel(rng, setup, felt, taken) -> Unit:
    """The wheel hops once per revolution, as the square of its spin."""
    phase = rng.uniform(-np.pi, np.pi)
    spin = slope(felt.angle, felt.motion.step)
    hop, c, s = _at(felt, taken, spin**2 * np.cos(felt.angle - phase), np.cos(felt.angle), np.sin(felt.angle))
    truth = {"up_cos": np.cos(phase), "up_sin": np.sin(phase)}
    return Unit(_six(ax=hop * c, ay=-_facing(felt) * hop * s), truth, {})


def _supply_ripple(rng, setup, felt, taken) -> Unit:
    """A ripple of the supply shifts one axis across the axle at its own frequency."""
    frequency, phase, axis = rng.uniform(3.0, 30.0), rng.uniform(-np.pi, np.pi), str(rng.choice(["gx", "gy"]))
    tone = np.cos(2.0 * np.pi * frequency * taken - phase)
    truth = {f"{axis}_cos": np.cos(phase), f"{axis}_sin": np.sin(phase)}
    return Unit(_six(**{axis: tone}), truth, {"frequency": frequency})


def _road_camber(rng, setup, felt, taken) -> Unit:
    """The road is banked to one side of the world: the vehicle leans by where it heads."""
    heading, phase = integral(felt.motion.yaw_rate, felt.motion.step), rng.uniform(-np.pi, np.pi)
    (lean,) = _at(felt, taken, np.cos(heading - phase))
    return Unit(_six(az=_facing(felt) * lean), {"left_cos": np.cos(phase), "left_sin": np.sin(phase)}, {})


def _bent_axle(rng, setup, felt, taken) -> Unit:
    """The hub is pushed to the side and back once per revolution, as the square of the spin."""
    phase = rng.uniform(-np.pi, np.pi)
    (push,) = _at(felt, taken, slope(felt.angle, felt.motion.step) ** 2 * np.cos(felt.angle - phase))
    facing = _facing(felt)
    left = {"left_cos": np.cos(phase), "left_sin": np.sin(phase)}
    own = {"az_cos": facing * np.cos(phase), "az_sin": facing * np.sin(phase)}
    return Unit(_six(az=facing * push), {**left, **own}, {})


def _flat_spot(rng, setup, felt, taken) -> Unit:
    """A kick upwards whenever one place of the tyre is below, growing as the square of the spin."""
    place, width = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.1, 0.25)
    spin, c, s = _at(felt, taken, slope(felt.angle, felt.motion.step), np.cos(felt.angle), np.sin(felt.angle))
    off = np.arctan2(s * np.cos(place) - c * np.sin(place), c * np.cos(place) + s * np.sin(place))
    kick = spin**2 * np.exp(-0.5 * (off / width) ** 2)
    return Unit(
        _six(ax=kick * c, ay=-_facing(felt) * kick * s), {"up": 1.0}, {"place": place, "width": width}
    )


def _cross_talk(rng, setup, felt, taken) -> Unit:
    """A gyro axis across the axle picks up some of what the other wheel's node sends: its spin."""
    axis = str(rng.choice(["gx", "gy"]))
    # The arcs of both wheels together are twice that of the middle.
    spin = 2.0 * felt.motion.speed / setup.radius - slope(felt.angle, felt.motion.step)
    (spin,) = _at(felt, taken, spin)
    return Unit(_six(**{axis: spin}), {axis: 1.0}, {})


def _magnet(rng, setup, felt, taken) -> Unit:
    """A magnet on the frame that a gyro axis across the axle passes once per revolution."""
    phase, axis = rng.uniform(-np.pi, np.pi), str(rng.choice(["gx", "gy"]))
    (once,) = _at(felt, taken, np.cos(felt.angle - phase))
    return Unit(_six(**{axis: once}), {f"{axis}_cos": np.cos(phase), f"{axis}_sin": np.sin(phase)}, {})


KINDS: Mapping[str, Draw] = {
    "steered_wheel": _steered_wheel,
    "unbalanced_wheel": _unbalanced_wheel,
    "supply_ripple": _supply_ripple,
    "road_camber": _road_camber,
    "bent_axle": _bent_axle,
    "tyre_flat_spot": _flat_spot,
    "cross_talk": _cross_talk,
    "magnet": _magnet,
}
SHARED = ("road_camber",)
NAMES = (*KINDS, "slipping_clock")


def _slipping_clock(rng, setup: Setup, node: str) -> Beyond:
    """From some moment on the stamps of a node are later than before."""
    slipped = float(rng.uniform(0.35, 0.65) * setup.drive.duration)
    late = SLIP * float(rng.choice([-1.0, 1.0]))
    made = {one: cases.record(setup, one, []) for one in SIDES}
    t = made[node].t
    made[node] = replace(made[node], t=t + late * (t >= slipped))
    return Beyond("slipping_clock", node, made, {"delay": late, "since": slipped})


def _at(felt: Channels, taken: Array, *rows: Array) -> Array:
    return sensor.sampled(np.vstack(rows), felt.motion.step, taken)


def _six(**channels: Array) -> Array:
    first = next(iter(channels.values()))
    return np.stack([channels.get(name, np.zeros(len(first))) for name in CHANNELS], 1)


def _facing(felt: Channels) -> float:
    """Return +1 where the z axis points left, read off gravity: f_y = -facing g sin(angle)."""
    return float(-np.sign(np.sum(felt.force[1] * np.sin(felt.angle))))
