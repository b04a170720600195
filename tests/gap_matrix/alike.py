"""Pairs of confusable effects, each with a log that does not distinguish them.

On an ordinary drive with all channels each pair can be told apart. Where it cannot, the right answer is both
names, or little confidence in one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gap_matrix import cases, effects
from gap_matrix.cases import Setup
from gap_matrix.drives import Drive
from gap_matrix.effects import SIDES, Effect
from gap_matrix.sensor import Record
from gap_matrix.world import Motion

SECONDS = 120.0
DRIVES = ("told apart", "blunt")


@dataclass(frozen=True)
class Pair:
    """Two effects in the form in which they are confusable.

    motion, temperature: of the blunt log. dead: `gyro`, `accel` or neither, whose channels are all zero
        there. why: what makes it blunt.
    """

    one: Effect
    other: Effect
    motion: str
    why: str
    dead: str = ""
    temperature: str = "as drawn"

    @property
    def name(self) -> str:
        return f"{self.one.name} / {self.other.name}"


def _effect(name: str, scope: str, **parameters: float) -> Effect:
    return Effect(name, scope, parameters)


_WARM = 30.0  # s
PAIRS = (
    Pair(
        _effect("wheel_radius", "left", error=0.003),
        _effect("gyro_scale_factor", "left", x=0.0, y=0.0, z=-0.003),
        "straight",
        "straight, no accelerometer: nothing counts revolutions",
        dead="accel",
    ),
    Pair(
        _effect("track_width", "vehicle", error=0.02),
        _effect("wheel_camber", "all", angle=0.03),
        "weave",
        "a slight weave, no accelerometer",
        dead="accel",
    ),
    Pair(
        _effect("gyro_g_sensitivity", "left", x=1e-4, y=1.5e-4, z=0.0),
        _effect("wheel_eccentricity", "left", amplitude=0.002, phase=0.7),
        "steady",
        "one speed, straight, no accelerometer",
        dead="accel",
    ),
    Pair(
        _effect("gyro_warmup", "left", x=0.003, y=-0.004, z=0.003, time_constant=_WARM),
        _effect("gyro_temperature", "left", x=5e-4, y=-4e-4, z=6e-4),
        "as drawn",
        "the temperature rises from 25 °C with the warm-up's own time constant",
        temperature="warming",
    ),
    Pair(
        _effect("gyro_bias", "right", x=0.003, y=-0.003, z=0.003),
        _effect("gyro_temperature", "right", x=5e-4, y=4e-4, z=-6e-4),
        "as drawn",
        "the temperature is always the same",
        temperature="constant",
    ),
    Pair(
        _effect("road_grade", "vehicle", angle=0.01),
        _effect("gyro_nonorthogonality", "all", xz=0.01, xy=0.0, yz=0.01, yx=0.0, zy=0.0, zx=0.0),
        "circle",
        "one circle at one speed, both nodes facing left",
    ),
    Pair(
        _effect("gyro_lag", "left", time_constant=0.002),
        _effect("time_offset", "left", delay=0.002),
        "as drawn",
        "no accelerometer",
        dead="accel",
    ),
    Pair(
        _effect("clock_skew", "left", ppm=20.0),
        _effect("wheel_radius", "left", error=-2e-5),
        "steady",
        "one speed, straight, no gyro",
        dead="gyro",
    ),
)


def blunt(seed: int, pair: Pair, seconds: float = SECONDS) -> Setup:
    """Return the setup of a seed on the log that does not distinguish a pair."""
    setup = cases.setup(seed, duration=seconds, vibration=0.0)
    rng = np.random.default_rng((seed, 9))
    t = setup.drive.motion.t
    still, speed = np.zeros(len(t)), np.full(len(t), rng.uniform(2.0, 4.0))
    turn = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.4)
    motion = {
        "as drawn": setup.drive.motion,
        "straight": Motion(setup.drive.motion.speed, still),
        "steady": Motion(speed, still),
        "circle": Motion(speed, still + turn),
        "weave": Motion(speed, 0.15 * np.sin(2.0 * np.pi * 0.5 * t)),
    }[pair.motion]
    temperature = {
        "as drawn": setup.drive.temperature,
        "constant": still + 18.0,
        "warming": 25.0 - 8.0 * np.expm1(-t / _WARM),
    }[pair.temperature]
    facing: Mapping[str, str] = dict.fromkeys(SIDES, "left") if pair.motion == "circle" else setup.facing
    return replace(setup, drive=Drive(motion, temperature, "drive"), facing=facing)


def records(setup: Setup, hidden: Iterable[Effect], dead: str = "") -> dict[str, Record]:
    """Return the records of both nodes, with zeros on dead channels."""
    made = {node: cases.record(setup, node, hidden) for node in effects.SIDES}
    alive = np.repeat([dead != "gyro", dead != "accel"], 3)
    return {node: replace(one, values=one.values * alive) for node, one in made.items()}
