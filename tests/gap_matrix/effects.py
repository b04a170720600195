"""Effects that can be hidden: parameters at a typical size, level and scaling."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

DEVELOPMENT_SEEDS = range(1000)
TEST_SEEDS = range(401_000, 402_000)
SIDES = ("left", "right")
VEHICLE = ("track_width", "road_grade")
AXES = ("x", "y", "z")
PAIRS = ("xz", "xy", "yz", "yx", "zy", "zx")


@dataclass(frozen=True)
class Effect:
    """A hidden effect.

    scope: `left`, `right`, `all` (both nodes, same numbers) or `vehicle`. parameters: as in the model file,
        SI. size: times the typical magnitude.
    """

    name: str
    scope: str
    parameters: Mapping[str, float]
    size: float = 1.0

    def concerns(self, node: str) -> bool:
        return self.scope in (node, "all", "vehicle")


@dataclass(frozen=True)
class _Kind:
    draw: Callable[[np.random.Generator], dict[str, float]]
    most: float  # no scaled parameter goes beyond (below, for a limit)
    lasting: str = ""  # a parameter that says what the effect is like, not how strong
    limit: bool = False  # the smaller the stronger


def _direction(typical: float, names: Iterable[str] = AXES):
    """Return a random vector of length `typical`."""

    def draw(rng):
        drawn = rng.standard_normal(len(tuple(names)))
        return dict(zip(names, (typical * drawn / np.linalg.norm(drawn)).tolist(), strict=True))

    return draw


def _one(name: str, typical: float, signed: bool = True):
    return lambda rng: {name: typical * (float(rng.choice([-1.0, 1.0])) if signed else 1.0)}


def _warmup(rng):
    return {**_direction(0.006)(rng), "time_constant": float(rng.uniform(15.0, 60.0))}


def _eccentric(rng):
    return {"amplitude": 0.005, "phase": float(rng.uniform(-np.pi, np.pi))}


def _outliers(rng):
    return {"probability": 0.003, "sigma": float(rng.uniform(3.0, 7.0))}


KINDS: dict[str, _Kind] = {
    "gyro_bias": _Kind(_direction(0.005), 1.0),
    "gyro_warmup": _Kind(_warmup, 1.0, lasting="time_constant"),
    "gyro_temperature": _Kind(_direction(0.0008), 0.1),
    "gyro_g_sensitivity": _Kind(_direction(2e-4), 0.05),
    "gyro_rate_random_walk": _Kind(_one("k", 5e-4, signed=False), 0.1),
    "gyro_scale_factor": _Kind(_direction(0.01), 0.3),
    "gyro_nonorthogonality": _Kind(_direction(0.01, PAIRS), 0.3),
    "gyro_cubic": _Kind(_one("z", 2e-5), 1e-3),
    "gyro_lag": _Kind(_one("time_constant", 0.005, signed=False), 0.3),
    "gyro_saturation": _Kind(_one("limit", 12.0, signed=False), 0.5, limit=True),
    "gyro_quantization": _Kind(_one("step", 0.01, signed=False), 0.5),
    "accel_bias": _Kind(_direction(0.1), 5.0),
    "accel_scale_factor": _Kind(_direction(0.01), 0.3),
    "accel_nonorthogonality": _Kind(_direction(0.01, PAIRS), 0.3),
    "accel_saturation": _Kind(_one("limit", 11.0, signed=False), 2.0, limit=True),
    "node_misalignment": _Kind(_direction(0.02), 0.4),
    "lever_arm": _Kind(_direction(0.01), 0.2),
    "wheel_radius": _Kind(_one("error", 0.003), 0.1),
    "tyre_growth": _Kind(_one("k", 1e-5, signed=False), 3e-4),
    "wheel_slip": _Kind(_one("k", 0.01, signed=False), 0.15),
    "wheel_eccentricity": _Kind(_eccentric, 0.2, lasting="phase"),
    "wheel_camber": _Kind(_one("angle", 0.05), 0.5),
    "track_width": _Kind(_one("error", 0.02), 0.3),
    "road_grade": _Kind(_one("angle", 0.02), 0.4),
    "time_offset": _Kind(_one("delay", 0.004), 0.1),
    "clock_skew": _Kind(_one("ppm", 100.0), 5000.0),
    "sample_repeat": _Kind(_one("probability", 0.01, signed=False), 0.4),
    "outliers": _Kind(_outliers, 0.4, lasting="sigma"),
}


def draw(name: str, rng: np.random.Generator, scope: str | None = None) -> Effect:
    """Draw the effect at its typical size: signs, directions and, unless given, the scope.

    ValueError when the name or the scope is none of the vocabulary's.
    """
    if name not in KINDS:
        raise ValueError(f"effect {name!r}: one of {', '.join(KINDS)}")
    fitting = ("vehicle",) if name in VEHICLE else (*SIDES, "all")
    drawn = fitting[int(rng.integers(len(fitting)))]
    if scope not in (None, *fitting):
        raise ValueError(f"{name}: scope {scope!r}, one of {', '.join(fitting)}")
    return Effect(name, scope or drawn, KINDS[name].draw(rng))


def scaled(effect: Effect, factor: float) -> Effect:
    """Return the effect `factor` times as strong; a limit is divided by it."""
    kind = KINDS[effect.name]
    times = 1.0 / factor if kind.limit else factor
    grown = {key: value if key == kind.lasting else value * times for key, value in effect.parameters.items()}
    return replace(effect, parameters=grown, size=effect.size * factor)


def possible(effect: Effect) -> bool:
    """Return True if a real wheel, node or clock could have it."""
    kind = KINDS[effect.name]
    sizes = [abs(value) for key, value in effect.parameters.items() if key != kind.lasting]
    return min(sizes) >= kind.most if kind.limit else max(sizes) <= kind.most


def settings(effects: Iterable[Effect], node: str) -> dict[str, Mapping[str, float]]:
    """Return the parameters that concern one node, by name."""
    return {effect.name: effect.parameters for effect in effects if effect.concerns(node)}
