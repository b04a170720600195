"""Library of expressions for new effects: dependences, and the quantities on which they act."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.dependence import pulse, steering_rate, temperature_rate
from hubodo.effects.sensor_chain import SensorChain

HELPERS = {"pulse": pulse, "steering_rate": steering_rate, "temperature_rate": temperature_rate}
HELPERS_WITH_MEMORY = ("temperature_rate",)
"""Helpers whose result depends on other samples, too."""


@dataclass(frozen=True)
class ShapeParameter:
    """A parameter of a shape other than an amplitude, such as a frequency.

    scale: usual error of the parameter
    fitted: False if its value is fixed
    """

    name: str
    unit: str
    value: float
    scale: float
    fitted: bool = True


@dataclass(frozen=True)
class Shape:
    """A dependence as Python expressions over `chain` and `self`: a common weight times several waves.

    weight_unit: unit of the weight; "" if it has none
    amplitudes: suffix of the name of each amplitude, and the expression of its wave
    is_shareable: True if all nodes may have the same amplitudes
    """

    weight: str
    weight_unit: str
    amplitudes: tuple[tuple[str, str], ...]
    description: str
    parameters: tuple[ShapeParameter, ...] = ()
    is_shareable: bool = True

    def columns(self, chain: SensorChain) -> Array:
        """Return the values, (k, N), per unit of each amplitude."""
        names = {
            "np": np,
            "chain": chain,
            "self": SimpleNamespace(**{parameter.name: parameter.value for parameter in self.parameters}),
        }
        rows = [
            np.asarray(_product(self.weight, wave, {**names, **HELPERS}), float)
            for _, wave in self.amplitudes
        ]
        return np.stack([np.broadcast_to(row, chain.t.shape) for row in rows])

    @property
    def needs_wheel(self) -> bool:
        """Return True if only a node on a wheel can have this dependence."""
        text = " ".join([self.weight, *(wave for _, wave in self.amplitudes)])
        return "chain.angle" in text or "chain.spin" in text


def _product(weight: str, wave: str, known: dict[str, object]) -> object:
    # Only the expressions of this file are evaluated.
    return eval(f"({weight}) * ({wave})", known)


@dataclass(frozen=True)
class Target:
    """A quantity that a term acts on.

    rows: indices of the six channels, and their factors
    unit: unit of an amplitude
    is_mirrored: True if its sign flips on a node facing right
    needs_wheel: True if it exists only for a node on a wheel
    """

    name: str
    unit: str
    rows: tuple[tuple[int, str], ...]
    is_mirrored: bool = False
    needs_wheel: bool = False


RATE, FORCE = "rad/s", "m/s²"
CHANNELS: tuple[Target, ...] = tuple(
    Target(name, RATE if row < 3 else FORCE, ((row, "1.0"),), is_mirrored=name[1] != "x")
    for row, name in enumerate(("gx", "gy", "gz", "ax", "ay", "az"))
)
VEHICLE_AXES: tuple[Target, ...] = (
    Target(
        "up",
        FORCE,
        ((3, "np.cos(chain.angle)"), (4, "-chain.facing * np.sin(chain.angle)")),
        needs_wheel=True,
    ),
    Target(
        "forward",
        FORCE,
        ((3, "np.sin(chain.angle)"), (4, "chain.facing * np.cos(chain.angle)")),
        needs_wheel=True,
    ),
    Target("left", FORCE, ((5, "chain.facing"),), needs_wheel=True),
    Target(
        "yaw",
        RATE,
        ((0, "np.cos(chain.angle)"), (1, "-chain.facing * np.sin(chain.angle)")),
        needs_wheel=True,
    ),
    Target(
        "roll",
        RATE,
        ((0, "np.sin(chain.angle)"), (1, "chain.facing * np.cos(chain.angle)")),
        needs_wheel=True,
    ),
)
TIME_STAMP = Target("delay", "s", ())

_CONSTANT_WAVE = (("", "1.0"),)
_SHAPE_WEIGHTS = {
    "chain.t": ("s", "more and more with time"),
    "chain.spin": ("rad/s", "in proportion to the spin"),
    "np.abs(chain.spin)": ("rad/s", "with the spin, either way alike"),
    "chain.spin**2": ("rad²/s²", "with the square of the spin"),
    "chain.opposite_spin": ("rad/s", "with the spin of the wheel on the other side"),
    "chain.speed": ("m/s", "in proportion to the speed"),
    "chain.speed**2": ("m²/s²", "with the square of the speed"),
    "chain.acceleration": ("m/s²", "while the speed changes"),
    "chain.yaw_rate": ("rad/s", "in turns"),
    "np.abs(chain.yaw_rate)": ("rad/s", "in turns, to either side alike"),
    "chain.speed * chain.yaw_rate": ("m/s²", "in turns at speed"),
    "chain.yaw_acceleration": ("rad/s²", "while turns begin and end"),
    "steering_rate(chain)": ("1/(m s)", "while the path bends more or less"),
    "chain.temperature - 25.0": ("°C", "with the temperature"),
    "temperature_rate(chain)": ("°C/s", "while the temperature changes"),
    "chain.force[0] * chain.force[1]": ("m²/s⁴", "with the product of the forces along x and y"),
    "chain.force[0] * chain.force[2]": ("m²/s⁴", "with the product of the forces along x and z"),
    "chain.force[1] * chain.force[2]": ("m²/s⁴", "with the product of the forces along y and z"),
}
_HARMONIC_WEIGHTS = {
    "1.0": ("", ""),
    "chain.spin": ("rad/s", ", in proportion to the spin"),
    "chain.spin**2": ("rad²/s²", ", with the square of the spin"),
    "chain.yaw_rate": ("rad/s", ", in turns"),
    "chain.acceleration": ("m/s²", ", while the speed changes"),
}
_HARMONIC_WORDS = ("once", "twice", "three times", "four times", "five times", "six times")


def list_shapes() -> Iterator[Shape]:
    """Yield all shapes that have no parameters other than amplitudes."""
    for weight, (per, words) in _SHAPE_WEIGHTS.items():
        yield Shape(weight, per, _CONSTANT_WAVE, words)
    yield Shape(
        "1.0", "", cosine_and_sine("chain.heading"), "once per turn of the vehicle: with where it heads"
    )
    for count, often in enumerate(_HARMONIC_WORDS, 1):
        angle = "chain.angle" if count == 1 else f"{count}.0 * chain.angle"
        for weight, (per, words) in _HARMONIC_WEIGHTS.items():
            # Initial angles differ between wheels, so wheels cannot share amplitudes.
            yield Shape(
                weight, per, cosine_and_sine(angle), f"{often} per revolution{words}", is_shareable=False
            )


def cosine_and_sine(angle: str) -> tuple[tuple[str, str], ...]:
    """Return suffix and expression of the cosine and the sine of an angle."""
    return (("_cos", f"np.cos({angle})"), ("_sin", f"np.sin({angle})"))


def build_tone(frequency: float, duration: float) -> Shape:
    """Return a tone of a frequency, Hz; a log of this duration, s, resolves it to a fraction of a cycle."""
    parameter = ShapeParameter("frequency", "Hz", frequency, 0.1 / duration)
    angle = "2.0 * np.pi * self.frequency * chain.t"
    return Shape("1.0", "", cosine_and_sine(angle), f"as a tone at {frequency:.4g} Hz", (parameter,))


def build_step(time: float) -> Shape:
    """Return a step shape that begins at a time, s."""
    parameter = ShapeParameter("since", "s", time, 1.0, fitted=False)
    return Shape("1.0", "", (("", "(chain.t >= self.since)"),), f"from {time:.1f} s on", (parameter,))


def build_bump(angle: float, width: float, weight: str) -> Shape:
    """Return a bump once per revolution, at a wheel angle and of a width in rad."""
    parameters = (ShapeParameter("place", "rad", angle, 0.05), ShapeParameter("width", "rad", width, 0.05))
    weight_unit, description = _HARMONIC_WEIGHTS[weight]
    amplitudes = (("", "pulse(chain.angle - self.place, self.width)"),)
    return Shape(
        weight,
        weight_unit,
        amplitudes,
        f"in one place of every revolution{description}",
        parameters,
        is_shareable=False,
    )
