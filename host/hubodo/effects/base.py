"""What every effect is: parameters with a unit and a usual size, a level, and one method at its stage."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from hubodo.arrays import Array
from hubodo.vehicle import Facing, Side, facing_sign

Level = Literal["vehicle", "wheel", "node"]
Shows = Literal["mean", "scatter"]
Follows = Literal["age", "temperature", "supply"]

REFERENCE_CELSIUS = 25.0
"""Temperature at which nothing that follows the temperature adds anything."""

REFERENCE_VOLTS = 3.7
"""Supply at which nothing that follows the supply adds anything."""

_LARGEST = 1e12
"""In the unit of any parameter: beyond it nothing was meant, and its square may be infinite."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """Vehicle and wheel as a node sees them, before the sensor. SI; angles in rad.

    growth: s²/rad². slip: s²/m. eccentricity: (A cos phase, A sin phase). lever_arm: (3,) m, node axes.
    aside: m, how far left of the middle of the vehicle the speed is measured.
    """

    side: Side | None
    radius: float
    track_width: float
    camber: float = 0.0
    grade: float = 0.0
    growth: float = 0.0
    slip: float = 0.0
    eccentricity: tuple[float, float] = (0.0, 0.0)
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    aside: float = 0.0


_AROUND = (
    "supply",
    "angle",
    "spin",
    "spin_beside",
    "speed",
    "acceleration",
    "yaw_rate",
    "yaw_acceleration",
    "heading",
)
"""What a chain has one of for each sample, or one for all."""


@dataclass(slots=True)
class Chain:
    """What travels down the sensor chain of one node, N samples; arrays of three are (3, N).

    t: s since power-on, or since the log began where that is not known. temperature: °C. rate, force: true
    angular rate and specific force at the sensor, after mounting (and low-pass). rate_derivative: of `rate`.
    gyro, accel: what is read. facing: +1 where the z axis points left, else -1. angle rad, spin rad/s: of the
    wheel, spin_beside rad/s: of the one on the other side, zero off them; speed m/s, acceleration m/s²,
    yaw_rate rad/s, yaw_acceleration rad/s², heading rad from the log's start: of the vehicle; zero where
    nobody needs them. supply: V. terms: what was worked out of all this.
    """

    t: Array
    temperature: Array
    rate: Array
    rate_derivative: Array
    force: Array
    gyro: Array
    accel: Array
    angle: Array | float = 0.0
    spin: Array | float = 0.0
    acceleration: Array | float = 0.0
    yaw_rate: Array | float = 0.0
    facing: float = 1.0
    spin_beside: Array | float = 0.0
    speed: Array | float = 0.0
    yaw_acceleration: Array | float = 0.0
    heading: Array | float = 0.0
    supply: Array | float = REFERENCE_VOLTS
    terms: dict[str, list[Array]] = field(default_factory=dict)

    def part(self, samples: slice) -> Chain:
        """Of some samples."""
        made = replace(self, t=self.t[samples], temperature=self.temperature[samples], terms={})
        for name in ("rate", "rate_derivative", "force", "gyro", "accel"):
            setattr(made, name, getattr(self, name)[:, samples])
        for name in _AROUND:
            value = getattr(self, name)
            setattr(made, name, value[samples] if isinstance(value, np.ndarray) else value)
        return made


@dataclass(frozen=True, slots=True)
class Noise:
    """1 sigma of one sample: gyro rad/s, accel m/s²."""

    gyro: float
    accel: float


@dataclass(frozen=True, slots=True)
class Estimate:
    """How the odometry believes a parameter before it has seen data, and how the parameter moves.

    prior: 1 sigma before the first sample, in the parameter's unit. walk: how far it wanders at random, per
    square root of a second. origin: where the numbers come from. shown_by: what to do so that a drive shows
    it. forgets: s, the time constant of a process that stays within `prior` (Gauss-Markov of first order);
    its walk is prior sqrt(2 / forgets).
    """

    prior: float
    walk: float
    origin: str
    shown_by: str = ""
    forgets: float = math.inf


def parameter(
    unit: str,
    scale: float,
    *,
    positive: bool = False,
    default: float = 0.0,
    within: float = math.inf,
    turned: bool = False,
    fitted: bool = True,
    estimate: Estimate | None = None,
) -> Any:
    """A field of an effect.

    scale: the size that would not surprise anybody. positive: whether it must be. within: the magnitude
    beyond which it means nothing. turned: whether its sign changes on a node that faces right, whose y and z
    axes are those of a node facing left negated: so does what has an odd number of indices y and z. fitted:
    whether a fit to a drive moves it. estimate: for what the odometry estimates while it drives.
    """
    about = {"unit": unit, "scale": scale, "positive": positive, "within": within}
    about |= {"turned": turned, "fitted": fitted, "estimate": estimate}
    return field(default=default, metadata=about)


@dataclass(frozen=True)
class Effect:
    """One way in which a measured wheel differs from an ideal one; its fields are its parameters.

    name: as in the model file. meaning: what it is to somebody who has the vehicle before him. level: what
    has one, the vehicle, each wheel or each node. shows: in the mean of the channels, or only in how they
    scatter. follows: what beside the motion it needs to be known. undone: whether a calibration takes it out
    of samples; its stage is inverted then. remembers: whether what it makes of a sample hangs on others, too,
    as what a filter answers: without it a long log is worked out some samples at a time. proportional:
    whether what it adds to a reading is in proportion to its coordinates. of_reference: whether it is of a
    speed that no node measured. alike:
    effect that a drive may not tell from this one -> the manoeuvre that does; it stands in one of the two.
    """

    name: ClassVar[str]
    meaning: ClassVar[str]
    level: ClassVar[Level] = "node"
    shows: ClassVar[Shows] = "mean"
    follows: ClassVar[Follows | None] = None
    undone: ClassVar[bool] = False
    remembers: ClassVar[bool] = False
    proportional: ClassVar[bool] = False
    of_reference: ClassVar[bool] = False
    alike: ClassVar[Mapping[str, str]] = {}

    @classmethod
    def parameters(cls) -> tuple[str, ...]:
        return _names(cls, fitted=False)

    @classmethod
    def fitted(cls) -> tuple[str, ...]:
        """The parameters that a fit to a drive moves."""
        return _names(cls, fitted=True)

    @classmethod
    def unit(cls, parameter: str) -> str:
        return str(cls._about(parameter)["unit"])

    @classmethod
    def scale(cls, parameter: str) -> float:
        return float(cls._about(parameter)["scale"])

    @classmethod
    def default(cls, parameter: str) -> float:
        """What a parameter is where nothing says it: zero, or else what makes the effect absent."""
        return float(cls.__dataclass_fields__[parameter].default)  # type: ignore[arg-type]

    @classmethod
    def sign(cls, parameter: str, facing: Facing) -> float:
        """-1 where a node facing right has the negated value of one facing left, else +1.

        The side of the vehicle changes no sign: what belongs to a node is in its own axes, what belongs to a
        wheel is the same on either (camber is positive inwards).
        """
        return facing_sign(facing) if cls._about(parameter)["turned"] else 1.0

    @classmethod
    def estimate(cls, parameter: str) -> Estimate | None:
        """What the odometry believes of a parameter beforehand; None where it does not estimate it."""
        found: Estimate | None = cls._about(parameter)["estimate"]
        return found

    @classmethod
    def problem(cls, parameter: str, value: float) -> str:
        """What is wrong with a value of a parameter, in words; "" where nothing is."""
        about = cls._about(parameter)
        if not math.isfinite(value):
            return "must be a finite number"
        # Where zero is the default it means that the effect is absent; elsewhere it means nothing.
        if about["positive"] and (value < 0.0 or (value == 0.0 and cls.default(parameter) != 0.0)):
            return "must be above 0"
        within = min(about["within"], _LARGEST)
        if abs(value) > within:
            return f"must lie within ±{within:g}"
        return ""

    @classmethod
    def _about(cls, parameter: str) -> Mapping[str, Any]:
        return cls.__dataclass_fields__[parameter].metadata

    def values(self) -> dict[str, float]:
        return {name: getattr(self, name) for name in self.parameters()}

    def spread(self, noise: Noise) -> tuple[float, float]:
        """Variance that it adds to a sample of each gyro and accelerometer axis, (rad/s)² and (m/s²)²."""
        return 0.0, 0.0

    def drift(self) -> float:
        """How fast each gyro axis wanders at random, (rad/s)² per second."""
        return 0.0

    def in_words(self) -> str:
        """What it is, with its size, where that says more to people than `meaning` and numbers; else ""."""
        return ""

    # How a fit moves it. The coordinates are the fitted parameters, unless an effect has better ones.

    @classmethod
    def seeds(cls) -> tuple[Self, ...]:
        """Where a fit may begin: absent, once for each value of what it cannot start from zero."""
        return (cls(),)

    @classmethod
    def coordinate_scales(cls) -> Array:
        """(k,) usual size of each coordinate; steps of numerical derivatives are 1e-3 of them."""
        return np.array([cls.scale(name) for name in cls.fitted()])

    def coordinates(self) -> Array:
        """(k,) where it stands, in coordinates in which the channels are smooth."""
        return np.array([getattr(self, name) for name in self.fitted()])

    def at(self, coordinates: Array) -> Self:
        """The effect at other coordinates, (k,)."""
        return replace(self, **dict(zip(self.fitted(), map(float, coordinates), strict=True)))

    def surprise(self) -> float:
        """-ln of how likely its parameters are beforehand, beside the usual, where sizes do not say it."""
        return 0.0

    def is_possible(self) -> bool:
        """Whether every parameter is finite and within what means anything."""
        return all(
            math.isfinite(value) and abs(value) <= self._about(name)["within"]
            for name, value in self.values().items()
        )

    # The stages of the chain, in order. An effect overrides the one where it enters.

    def true_time(self, t: Array) -> Array:
        """Time at which the samples stamped t, (N,) s since the log began, were taken."""
        return t

    def shape(self, geometry: Geometry) -> Geometry:
        """The geometry with this effect in it."""
        return geometry

    def mount(self, chain: Chain) -> None:
        """Turn what reaches the sensor."""

    def low_pass(self, chain: Chain) -> None:
        """Delay what the gyro answers to."""

    def respond(self, chain: Chain) -> None:
        """Scale, cross-axis and curvature: adds to gyro or accel what rate or force make."""

    def offset(self, chain: Chain) -> None:
        """Add to gyro or accel what is there without input."""

    def wander(self, chain: Chain, rng: np.random.Generator) -> None:
        """Add offsets drawn at random."""

    def scatter(self, chain: Chain, noise: Noise, rng: np.random.Generator) -> None:
        """Add what comes after the white noise."""

    def clip(self, chain: Chain) -> None:
        """Clip gyro or accel."""

    def digitize(self, chain: Chain) -> None:
        """Round gyro or accel."""

    def repeat(self, chain: Chain, rng: np.random.Generator) -> None:
        """Replace samples by their predecessors."""

    # The stages backwards, of effects that are `undone`. What `offset` adds is taken off; the matrices of
    # a triad (`LinearEffect`) are inverted together; the rest is here.

    def irreversible(self) -> str:
        """Why its numbers cannot be undone, in words; "" where they can."""
        return ""

    def straighten(self, rate: Array, inverse: Array) -> Array:
        """Undo what `respond` adds to the gyro beyond proportion.

        rate: (3, N) that the inverse of the gyro's matrix, (3, 3), makes of its reading.
        """
        return rate

    def unmount(self, chain: Chain) -> None:
        """Turn back what `mount` turned."""


_NAMES: dict[tuple[type[Effect], bool], tuple[str, ...]] = {}


def _names(kind: type[Effect], fitted: bool) -> tuple[str, ...]:
    """Of the parameters of an effect, or of those that a fit moves."""
    key = kind, fitted
    if key not in _NAMES:
        _NAMES[key] = tuple(item.name for item in fields(kind) if item.metadata["fitted"] or not fitted)
    return _NAMES[key]
