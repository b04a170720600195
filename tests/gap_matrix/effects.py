"""Effects that can be hidden: parameters at their typical size, scopes and scaling."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

DEVELOPMENT_SEEDS = range(1000)
TEST_SEEDS = range(401_000, 402_000)
SIDES = ("left", "right")
VEHICLE_EFFECTS = ("track_width", "road_grade")
AXES = ("x", "y", "z")
AXIS_PAIRS = ("xz", "xy", "yz", "yx", "zy", "zx")


@dataclass(frozen=True)
class Effect:
    """A hidden effect.

    scope: `left`, `right`, `all` (both nodes, same parameters) or `vehicle`
    parameters: as in the model file, SI units
    size: multiple of the typical size
    """

    name: str
    scope: str
    parameters: Mapping[str, float]
    size: float = 1.0

    def applies_to(self, node: str) -> bool:
        """Return True if the node has the effect."""
        return self.scope in (node, "all", "vehicle")


@dataclass(frozen=True)
class _Kind:
    """A kind of effect: its typical parameters and how they scale."""

    draw: Callable[[np.random.Generator], dict[str, float]]  # draws parameters at the typical size
    bound: float  # largest plausible parameter; the smallest one if it is a limit
    shape_parameter: str = ""  # a parameter that does not scale with the size
    is_limit: bool = False  # True if a smaller parameter means a stronger effect


def _random_vector(typical: float, names: Iterable[str] = AXES):
    """Return a function that draws a random vector of length `typical`."""

    def draw(rng):
        drawn_value = rng.standard_normal(len(tuple(names)))
        return dict(zip(names, (typical * drawn_value / np.linalg.norm(drawn_value)).tolist(), strict=True))

    return draw


def _single_parameter(name: str, typical: float, is_signed: bool = True):
    """Return a function that draws a single parameter of size `typical`, with a random sign if signed."""
    return lambda rng: {name: typical * (float(rng.choice([-1.0, 1.0])) if is_signed else 1.0)}


def _warmup(rng):
    return {**_random_vector(0.006)(rng), "time_constant": float(rng.uniform(15.0, 60.0))}


def _eccentric(rng):
    return {"amplitude": 0.005, "phase": float(rng.uniform(-np.pi, np.pi))}


def _outliers(rng):
    return {"probability": 0.003, "sigma": float(rng.uniform(3.0, 7.0))}


KINDS: dict[str, _Kind] = {
    "gyro_bias": _Kind(_random_vector(0.005), 1.0),
    "gyro_warmup": _Kind(_warmup, 1.0, shape_parameter="time_constant"),
    "gyro_temperature": _Kind(_random_vector(0.0008), 0.1),
    "gyro_g_sensitivity": _Kind(_random_vector(2e-4), 0.05),
    "gyro_rate_random_walk": _Kind(_single_parameter("k", 5e-4, is_signed=False), 0.1),
    "gyro_scale_factor": _Kind(_random_vector(0.01), 0.3),
    "gyro_nonorthogonality": _Kind(_random_vector(0.01, AXIS_PAIRS), 0.3),
    "gyro_cubic": _Kind(_single_parameter("z", 2e-5), 1e-3),
    "gyro_lag": _Kind(_single_parameter("time_constant", 0.005, is_signed=False), 0.3),
    "gyro_saturation": _Kind(_single_parameter("limit", 12.0, is_signed=False), 0.5, is_limit=True),
    "gyro_quantization": _Kind(_single_parameter("step", 0.01, is_signed=False), 0.5),
    "accel_bias": _Kind(_random_vector(0.1), 5.0),
    "accel_scale_factor": _Kind(_random_vector(0.01), 0.3),
    "accel_nonorthogonality": _Kind(_random_vector(0.01, AXIS_PAIRS), 0.3),
    "accel_saturation": _Kind(_single_parameter("limit", 11.0, is_signed=False), 2.0, is_limit=True),
    "node_misalignment": _Kind(_random_vector(0.02), 0.4),
    "lever_arm": _Kind(_random_vector(0.01), 0.2),
    "wheel_radius": _Kind(_single_parameter("error", 0.003), 0.1),
    "tyre_growth": _Kind(_single_parameter("k", 1e-5, is_signed=False), 3e-4),
    "wheel_slip": _Kind(_single_parameter("k", 0.01, is_signed=False), 0.15),
    "wheel_eccentricity": _Kind(_eccentric, 0.2, shape_parameter="phase"),
    "wheel_camber": _Kind(_single_parameter("angle", 0.05), 0.5),
    "track_width": _Kind(_single_parameter("error", 0.02), 0.3),
    "road_grade": _Kind(_single_parameter("angle", 0.02), 0.1),
    "time_offset": _Kind(_single_parameter("delay", 0.004), 0.1),
    "clock_skew": _Kind(_single_parameter("ppm", 100.0), 5000.0),
    "sample_repeat": _Kind(_single_parameter("probability", 0.01, is_signed=False), 0.4),
    "outliers": _Kind(_outliers, 0.4, shape_parameter="sigma"),
}


def draw_effect(name: str, rng: np.random.Generator, scope: str | None = None) -> Effect:
    """Return an effect at its typical size with random signs and directions, and a random scope by default.

    Raises ValueError if the name or the scope is unknown.
    """
    if name not in KINDS:
        raise ValueError(f"effect {name!r}: one of {', '.join(KINDS)}")
    scopes = ("vehicle",) if name in VEHICLE_EFFECTS else (*SIDES, "all")
    drawn_value = scopes[int(rng.integers(len(scopes)))]
    if scope not in (None, *scopes):
        raise ValueError(f"{name}: scope {scope!r}, one of {', '.join(scopes)}")
    return Effect(name, scope or drawn_value, KINDS[name].draw(rng))


def scale_effect(effect: Effect, factor: float) -> Effect:
    """Return the effect `factor` times as strong; a limit is divided by it."""
    kind = KINDS[effect.name]
    multiplier = 1.0 / factor if kind.is_limit else factor
    scaled_parameters = {
        key: value if key == kind.shape_parameter else value * multiplier
        for key, value in effect.parameters.items()
    }
    return replace(effect, parameters=scaled_parameters, size=effect.size * factor)


def is_possible(effect: Effect) -> bool:
    """Return True if the effect is plausible for a real wheel, node or clock."""
    kind = KINDS[effect.name]
    sizes = [abs(value) for key, value in effect.parameters.items() if key != kind.shape_parameter]
    return min(sizes) >= kind.bound if kind.is_limit else max(sizes) <= kind.bound


def parameters_on_node(effects: Iterable[Effect], node: str) -> dict[str, Mapping[str, float]]:
    """Return the parameters of the effects of one node, by effect name."""
    return {effect.name: effect.parameters for effect in effects if effect.applies_to(node)}
