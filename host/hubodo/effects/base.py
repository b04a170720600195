"""Base class of all effects, and the declaration of their parameters.

An effect is one cause by which readings differ from those of an ideal sensor on an ideal wheel. It is a
frozen dataclass whose fields are its parameters, and it overrides the method of the stage of the sensor chain
at which it enters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.sensor_chain import Geometry, Noise, SensorChain
from hubodo.vehicle import Facing, facing_sign

Level = Literal["vehicle", "wheel", "node"]
Visibility = Literal["mean", "scatter"]
Dependency = Literal["age", "temperature", "supply"]

_PLAUSIBLE_SCALES = 20.0
"""Largest plausible magnitude of a parameter that states none, in its scales."""

_MAX_PARAMETER_MAGNITUDE = 1e12
"""Bound on any parameter in its own unit: no real value is larger, and its square stays finite."""


@dataclass(frozen=True, slots=True)
class OdometryPrior:
    """Prior and process noise of a parameter that the odometry estimates online.

    Attributes
    ----------
    sigma : 1σ before the first sample, in the unit of the parameter.
    random_walk : 1σ of the random walk after one second, in the unit of the parameter per √s.
    origin : source of both numbers.
    manoeuvre : instruction to the driver that makes the parameter observable.
    correlation_time : s, time constant T of a first-order Gauss-Markov process with standard deviation
        `sigma`; its `random_walk` is sigma √(2 / T). Infinite for a pure random walk.
    """

    sigma: float
    random_walk: float
    origin: str
    manoeuvre: str = ""
    correlation_time: float = math.inf


def parameter(
    unit: str,
    scale: float,
    *,
    positive: bool = False,
    default: float = 0.0,
    max_magnitude: float = math.inf,
    max_plausible: float | None = None,
    flips_with_facing: bool = False,
    fitted: bool = True,
    odometry_prior: OdometryPrior | None = None,
) -> Any:
    """Declare a parameter of an effect, as a field of its dataclass.

    Parameters
    ----------
    unit : unit as text; "1" for a ratio.
    scale : 1σ of the prior that `hubodo gap` uses, in that unit.
    positive : True if negative values are invalid.
    default : value that makes the effect absent.
    max_magnitude : largest valid magnitude.
    max_plausible : largest magnitude of a working sensor, mounting or vehicle; a fit beyond it indicates
        another cause. By default 20 times the scale, and infinite for a positive parameter.
    flips_with_facing : True if the parameter changes sign on a node that faces right. The y and z axes of
        such a node are negated, and so is a parameter with an odd number of indices y and z.
    fitted : False if a fit to a drive must not move the parameter.
    odometry_prior : prior of a parameter that the odometry estimates online.
    """
    if max_plausible is None:
        max_plausible = math.inf if positive else _PLAUSIBLE_SCALES * scale
    metadata = {"unit": unit, "scale": scale, "positive": positive, "max_magnitude": max_magnitude}
    metadata["max_plausible"] = max_plausible
    metadata |= {"flips_with_facing": flips_with_facing, "fitted": fitted, "odometry_prior": odometry_prior}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Effect:
    """Base class of effects; a subclass declares its parameters and overrides the method of one stage.

    Attributes
    ----------
    name : name in model files and results.
    meaning : cause in plain words, for a reader who has the vehicle in front of them.
    level : owner of the parameters: the vehicle, each wheel or each node.
    visible_in : "mean" if the effect moves the channels, "scatter" if it only changes their noise or clips
        them.
    depends_on : quantity that the effect needs in addition to the motion: age, temperature or supply.
    is_invertible : True if a calibration removes the effect from samples.
    has_memory : True if a reading depends on earlier samples, as with a filter. Without memory a long log is
        evaluated in blocks.
    is_linear : True if the change of a reading is proportional to the coordinates.
    varies_between_drives : True if the value holds for one drive only, as that of an offset, a clock or the
        road.
    affects_reference : True if the effect concerns the speed reference rather than a node.
    confusable_with : name of an effect that a drive may not distinguish from this one -> manoeuvre that does.
        Each pair is listed in one of its two classes.
    """

    name: ClassVar[str]
    meaning: ClassVar[str]
    level: ClassVar[Level] = "node"
    visible_in: ClassVar[Visibility] = "mean"
    depends_on: ClassVar[Dependency | None] = None
    is_invertible: ClassVar[bool] = False
    has_memory: ClassVar[bool] = False
    is_linear: ClassVar[bool] = False
    varies_between_drives: ClassVar[bool] = False
    affects_reference: ClassVar[bool] = False
    confusable_with: ClassVar[Mapping[str, str]] = {}

    @classmethod
    def parameters(cls) -> tuple[str, ...]:
        """Return the names of all parameters."""
        return _parameter_names(cls, fitted=False)

    @classmethod
    def fitted_parameters(cls) -> tuple[str, ...]:
        """Return the names of the parameters that a fit to a drive moves."""
        return _parameter_names(cls, fitted=True)

    @classmethod
    def unit(cls, parameter: str) -> str:
        """Return the unit of a parameter as text."""
        return str(cls._metadata(parameter)["unit"])

    @classmethod
    def scale(cls, parameter: str) -> float:
        """Return the 1σ prior of a parameter in its unit."""
        return float(cls._metadata(parameter)["scale"])

    @classmethod
    def max_plausible(cls, parameter: str) -> float:
        """Return the largest magnitude of a parameter that a working sensor, mounting or vehicle has."""
        return float(cls._metadata(parameter)["max_plausible"])

    @classmethod
    def default(cls, parameter: str) -> float:
        """Return the value of a parameter that is not given; it makes the effect absent."""
        return float(cls.__dataclass_fields__[parameter].default)  # type: ignore[arg-type]

    @classmethod
    def facing_sign_of(cls, parameter: str, facing: Facing) -> float:
        """Return -1 where a node facing right has the negated value of a node facing left, else +1.

        The side of the vehicle changes no sign: parameters of a node are stated in its own axes, and those of
        a wheel are the same on both sides (camber is positive inwards).
        """
        return facing_sign(facing) if cls._metadata(parameter)["flips_with_facing"] else 1.0

    @classmethod
    def odometry_prior(cls, parameter: str) -> OdometryPrior | None:
        """Return the prior of the odometry; None for a parameter that it does not estimate."""
        prior: OdometryPrior | None = cls._metadata(parameter)["odometry_prior"]
        return prior

    @classmethod
    def invalid_reason(cls, parameter: str, value: float) -> str:
        """Return why a value of a parameter is invalid; "" if it is valid."""
        metadata = cls._metadata(parameter)
        if not math.isfinite(value):
            return "must be a finite number"
        # Zero is valid where it is the default and makes the effect absent.
        if metadata["positive"] and (value < 0.0 or (value == 0.0 and cls.default(parameter) != 0.0)):
            return "must be above 0"
        bound = min(metadata["max_magnitude"], _MAX_PARAMETER_MAGNITUDE)
        if abs(value) > bound:
            return f"must lie within ±{bound:g}"
        return ""

    @classmethod
    def _metadata(cls, parameter: str) -> Mapping[str, Any]:
        return cls.__dataclass_fields__[parameter].metadata

    def values(self) -> dict[str, float]:
        """Return all parameters by name."""
        return {name: getattr(self, name) for name in self.parameters()}

    def added_variance(self, noise: Noise) -> tuple[float, float]:
        """Return the variance added to a sample of each gyro and each accel axis, (rad/s)² and (m/s²)²."""
        return 0.0, 0.0

    def random_walk_variance_rate(self) -> float:
        """Return the growth of the variance of each gyro bias, (rad/s)² per second."""
        return 0.0

    def bank_process(self) -> tuple[float, float]:
        """Return 1σ, rad, and correlation length, m, of a random bank of the road along the path."""
        return 0.0, math.inf

    def is_process(self) -> bool:
        """Return True if the effect is a random process that a filter follows, such as a drift."""
        return self.random_walk_variance_rate() > 0.0 or self.bank_process()[0] > 0.0

    def describe(self) -> str:
        """Return a sentence with the size of the effect; "" where `meaning` and the numbers suffice."""
        return ""

    # Coordinates of a fit: the fitted parameters, unless a subclass defines better-conditioned ones.

    @classmethod
    def initial_guesses(cls) -> tuple[Self, ...]:
        """Return starting points of a fit: zero effect, once for each guess of a nonlinear parameter."""
        return (cls(),)

    @classmethod
    def coordinate_scales(cls) -> Array:
        """Return the (k,) prior 1σ of the coordinates; numerical derivatives use steps of 1e-3 of them."""
        return np.array([cls.scale(name) for name in cls.fitted_parameters()])

    def coordinates(self) -> Array:
        """Return the (k,) coordinates, in which the channels are smooth functions."""
        return np.array([getattr(self, name) for name in self.fitted_parameters()])

    def with_coordinates(self, coordinates: Array) -> Self:
        """Return the effect at other coordinates, (k,)."""
        return replace(self, **dict(zip(self.fitted_parameters(), map(float, coordinates), strict=True)))

    def neg_log_prior(self) -> float:
        """Return -ln of the prior probability of the parameters, beyond their Gaussian scale priors."""
        return 0.0

    def is_valid(self) -> bool:
        """Return True if every parameter is finite and within its largest magnitude."""
        return all(
            math.isfinite(value) and abs(value) <= self._metadata(name)["max_magnitude"]
            for name, value in self.values().items()
        )

    # Stages of the sensor chain, in order. An effect overrides the stage at which it enters.

    def true_time(self, t: Array) -> Array:
        """Return the sampling times of samples stamped t, (N,) s since the start of the log."""
        return t

    def adjust_geometry(self, geometry: Geometry) -> Geometry:
        """Return the geometry with this effect."""
        return geometry

    def axle_rotation(self) -> float:
        """Return the angle by which the node is rotated about its nominal z axis, rad."""
        return 0.0

    def rotate_into_node(self, chain: SensorChain) -> None:
        """Rotate rate and force from the nominal axes into the axes of the node."""

    def low_pass_rate(self, chain: SensorChain) -> None:
        """Low-pass filter the rate ahead of the gyro."""

    def add_scale_errors(self, chain: SensorChain) -> None:
        """Add scale, cross-axis and cubic errors of rate or force to the readings."""

    def add_offsets(self, chain: SensorChain) -> None:
        """Add offsets that are not proportional to the measured quantity to the readings."""

    def add_random_walk(self, chain: SensorChain, rng: np.random.Generator) -> None:
        """Add a random walk to the readings."""

    def add_outliers(self, chain: SensorChain, noise: Noise, rng: np.random.Generator) -> None:
        """Add errors that follow the white noise to the readings."""

    def clip_readings(self, chain: SensorChain) -> None:
        """Clip the readings at the range of the sensor."""

    def quantize_readings(self, chain: SensorChain) -> None:
        """Round the readings to multiples of the resolution."""

    def repeat_samples(self, chain: SensorChain, rng: np.random.Generator) -> None:
        """Replace samples by their predecessors."""

    # Inverse stages of invertible effects. A calibration subtracts what `add_offsets` adds and inverts the
    # matrices of a triad (`LinearEffect`) together; the methods below invert the other stages.

    def why_irreversible(self) -> str:
        """Return why the parameters cannot be inverted; "" if they can."""
        return ""

    def remove_nonlinearity(self, rate: Array, inverse: Array) -> Array:
        """Return the rate without the nonlinear part of `add_scale_errors`.

        Parameters
        ----------
        rate : (3, N) rad/s, reading of the gyro times the inverse of its matrix.
        inverse : (3, 3), inverse of the gyro's matrix.
        """
        return rate

    def rotate_out_of_node(self, chain: SensorChain) -> None:
        """Invert `rotate_into_node`."""


_PARAMETER_NAMES: dict[tuple[type[Effect], bool], tuple[str, ...]] = {}


def _parameter_names(kind: type[Effect], fitted: bool) -> tuple[str, ...]:
    """Return the names of all parameters of an effect, or of the fitted ones; the result is cached."""
    key = kind, fitted
    if key not in _PARAMETER_NAMES:
        names = tuple(item.name for item in fields(kind) if item.metadata["fitted"] or not fitted)
        _PARAMETER_NAMES[key] = names
    return _PARAMETER_NAMES[key]
