"""Pairs of confusable effects, each with a log that does not distinguish them.

On an ordinary drive with all channels, the effects of a pair are distinguishable. On the ambiguous ("blunt")
log of a pair, the correct answer is both names, or one name with low confidence.
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

DURATION_S = 120.0
VARIANTS = ("distinguishable", "blunt")


@dataclass(frozen=True)
class ConfusablePair:
    """Two effects with the parameters that make them confusable.

    motion, temperature: keys of the motion and temperature of the ambiguous log
    reason: reason for the ambiguity, as printed
    dead_sensor: `gyro`, `accel` or empty: the sensor whose channels are all zero in the ambiguous log
    """

    first: Effect
    second: Effect
    motion: str
    reason: str
    dead_sensor: str = ""
    temperature: str = "as drawn"

    @property
    def name(self) -> str:
        """Return both names, as printed and as a key of cells."""
        return f"{self.first.name} / {self.second.name}"


def _effect(name: str, scope: str, **parameters: float) -> Effect:
    return Effect(name, scope, parameters)


_WARMUP_TIME_CONSTANT = 30.0  # s
CONFUSABLE_PAIRS = (
    ConfusablePair(
        _effect("wheel_radius", "left", error=0.003),
        _effect("gyro_scale_factor", "left", x=0.0, y=0.0, z=-0.003),
        "straight",
        "straight, no accelerometer: revolutions are not observable",
        dead_sensor="accel",
    ),
    ConfusablePair(
        _effect("track_width", "vehicle", error=0.02),
        _effect("wheel_camber", "all", angle=0.03),
        "weave",
        "a slight weave, no accelerometer",
        dead_sensor="accel",
    ),
    ConfusablePair(
        _effect("gyro_g_sensitivity", "left", x=1e-4, y=1.5e-4, z=0.0),
        _effect("wheel_eccentricity", "left", amplitude=0.002, phase=0.7),
        "steady",
        "one speed, straight, no accelerometer",
        dead_sensor="accel",
    ),
    ConfusablePair(
        _effect("gyro_warmup", "left", x=0.003, y=-0.004, z=0.003, time_constant=_WARMUP_TIME_CONSTANT),
        _effect("gyro_temperature", "left", x=5e-4, y=-4e-4, z=6e-4),
        "as drawn",
        "the temperature rises from 25 °C with the warm-up's own time constant",
        temperature="warming",
    ),
    ConfusablePair(
        _effect("gyro_bias", "right", x=0.003, y=-0.003, z=0.003),
        _effect("gyro_temperature", "right", x=5e-4, y=4e-4, z=-6e-4),
        "as drawn",
        "the temperature is constant",
        temperature="constant",
    ),
    ConfusablePair(
        _effect("road_grade", "vehicle", angle=0.01),
        _effect("gyro_nonorthogonality", "all", xz=0.01, xy=0.0, yz=0.01, yx=0.0, zy=0.0, zx=0.0),
        "circle",
        "one circle at one speed, both nodes facing left",
    ),
    ConfusablePair(
        _effect("gyro_lag", "left", time_constant=0.002),
        _effect("time_offset", "left", delay=0.002),
        "as drawn",
        "no accelerometer",
        dead_sensor="accel",
    ),
    ConfusablePair(
        _effect("clock_skew", "left", ppm=20.0),
        _effect("wheel_radius", "left", error=-2e-5),
        "steady",
        "one speed, straight, no gyro",
        dead_sensor="gyro",
    ),
)


def draw_ambiguous_setup(seed: int, pair: ConfusablePair, duration: float = DURATION_S) -> Setup:
    """Return the setup of a seed with a motion and temperature that do not distinguish a pair."""
    setup = cases.draw_setup(seed, duration=duration, vibration=0.0)
    rng = np.random.default_rng((seed, 9))
    t = setup.drive.motion.t
    zeros, speed = np.zeros(len(t)), np.full(len(t), rng.uniform(2.0, 4.0))
    yaw_rate = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.4)
    motion = {
        "as drawn": setup.drive.motion,
        "straight": Motion(setup.drive.motion.speed, zeros),
        "steady": Motion(speed, zeros),
        "circle": Motion(speed, zeros + yaw_rate),
        "weave": Motion(speed, 0.15 * np.sin(2.0 * np.pi * 0.5 * t)),
    }[pair.motion]
    temperature = {
        "as drawn": setup.drive.temperature,
        "constant": zeros + 18.0,
        "warming": 25.0 - 8.0 * np.expm1(-t / _WARMUP_TIME_CONSTANT),
    }[pair.temperature]
    facing: Mapping[str, str] = dict.fromkeys(SIDES, "left") if pair.motion == "circle" else setup.facing
    return replace(setup, drive=Drive(motion, temperature, "drive"), facing=facing)


def simulate_records(setup: Setup, hidden: Iterable[Effect], dead_sensor: str = "") -> dict[str, Record]:
    """Return the simulated records of both nodes, with zeros on the channels of the dead sensor."""
    records = {node: cases.simulate_node_record(setup, node, hidden) for node in effects.SIDES}
    is_alive = np.repeat([dead_sensor != "gyro", dead_sensor != "accel"], 3)
    return {node: replace(record, values=record.values * is_alive) for node, record in records.items()}
