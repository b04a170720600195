"""Empirical effects: a term of a library, added to channels of a node with fitted amplitudes.

`empirical:gz ~ spin^2*cos(2*theta)` adds that term to gz. The name fixes channels and term; the parameters
are the amplitudes. A periodic term has two amplitudes, for cosine and sine.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import make_dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array, sin_cos
from hubodo.effects.base import Effect, parameter
from hubodo.effects.dependence import temperature_rate
from hubodo.effects.sensor_chain import SensorChain

PREFIX = "empirical:"
CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")
N_HARMONICS = 6
"""Number of wheel harmonics in the term `harmonics(theta)`."""
_GYRO_AMPLITUDE_SCALE, _ACCEL_AMPLITUDE_SCALE = (
    0.01,
    0.1,
)  # rad/s and m/s², 1σ of an amplitude per unit of its term


def _per_sample(chain: SensorChain, value: Array | float) -> Array:
    """Return a value, or one value per sample, as (N,)."""
    return np.broadcast_to(np.asarray(value, float), chain.t.shape)


FACTORS: dict[str, Callable[[SensorChain], Array]] = {
    "1": lambda chain: np.ones_like(chain.t),
    "t": lambda chain: chain.t,
    "spin": lambda chain: _per_sample(chain, chain.spin),
    "spin^2": lambda chain: _per_sample(chain, chain.spin) ** 2,
    "abs(spin)": lambda chain: np.abs(_per_sample(chain, chain.spin)),
    "speed": lambda chain: _per_sample(chain, chain.speed),
    "speed^2": lambda chain: _per_sample(chain, chain.speed) ** 2,
    "acceleration": lambda chain: _per_sample(chain, chain.acceleration),
    "sign(acceleration)": lambda chain: np.tanh(_per_sample(chain, chain.acceleration) / 0.05),
    "yaw_rate": lambda chain: _per_sample(chain, chain.yaw_rate),
    "abs(yaw_rate)": lambda chain: np.abs(_per_sample(chain, chain.yaw_rate)),
    "temperature": lambda chain: chain.temperature - 25.0,
    "temperature_rate": temperature_rate,
    "fx*fy": lambda chain: chain.force[0] * chain.force[1],
    "fx*fz": lambda chain: chain.force[0] * chain.force[2],
    "fy*fz": lambda chain: chain.force[1] * chain.force[2],
}
_HARMONIC_PATTERN = re.compile(r"cos\((\d+)\*theta\)")
_TONE_PATTERN = re.compile(r"cos\(2\*pi\*([0-9.]+)\*t\)")
_STEP_PATTERN = re.compile(r"step\(t-([0-9.]+)\)")
ALL_HARMONICS = "harmonics(theta)"


def evaluate_term(expression: str, chain: SensorChain) -> list[Array]:
    """Return the values of a term of the library, column by column.

    Parameters
    ----------
    expression : product of factors, such as "spin^2*cos(2*theta)".
    chain : signals of N samples.

    Returns
    -------
    list of (N,) arrays
        One column; two for a periodic term; 2 `N_HARMONICS` for "harmonics(theta)".

    Raises
    ------
    ValueError
        If a factor is not in the library.
    """
    real, periodic = np.ones_like(chain.t), [np.ones_like(chain.t)]
    for factor in _split(expression):
        if factor in FACTORS:
            real = real * FACTORS[factor](chain)
        elif match := _HARMONIC_PATTERN.fullmatch(factor):
            angle = int(match[1]) * _per_sample(chain, chain.angle)
            sin, cos = sin_cos(angle)
            periodic = [cos, sin]
        elif match := _TONE_PATTERN.fullmatch(factor):
            angle = 2.0 * math.pi * float(match[1]) * chain.t
            sin, cos = sin_cos(angle)
            periodic = [cos, sin]
        elif match := _STEP_PATTERN.fullmatch(factor):
            real = real * (chain.t >= float(match[1]))
        elif factor == ALL_HARMONICS:
            sin, cos = sin_cos(_per_sample(chain, chain.angle))
            fundamental = harmonic = cos + 1j * sin
            periodic = [harmonic.real.copy(), harmonic.imag.copy()]
            while len(periodic) < 2 * N_HARMONICS:
                harmonic = harmonic * fundamental
                periodic += [harmonic.real.copy(), harmonic.imag.copy()]
        else:
            raise ValueError(
                f"unknown term {factor!r}; known terms: {', '.join(FACTORS)}, cos(2*theta), step(t-10)"
            )
    for wave in periodic:
        # Scale in place, because the columns of a long log are large.
        wave *= real
    return periodic


def _split(expression: str) -> list[str]:
    """Split an expression at its stars outside brackets; a product of two forces is one factor."""
    factors, depth, start = [], 0, 0
    for k, letter in enumerate(expression):
        depth += (letter == "(") - (letter == ")")
        if letter == "*" and depth == 0:
            factors.append(expression[start:k])
            start = k + 1
    factors.append(expression[start:])
    merged: list[str] = []
    for factor in factors:
        if merged and f"{merged[-1]}*{factor}" in FACTORS:
            merged[-1] = f"{merged[-1]}*{factor}"
        else:
            merged.append(factor)
    return merged


def _suffixes(expression: str) -> list[str]:
    """Return one suffix of a parameter name for each column of a term."""
    factors = _split(expression)
    if ALL_HARMONICS in factors:
        return [f"_{wave}{k}" for k in range(1, N_HARMONICS + 1) for wave in ("cos", "sin")]
    return ["_cos", "_sin"] if any("cos(" in factor for factor in factors) else [""]


class _Empirical(Effect):
    """Base class of empirical effects."""

    is_linear: ClassVar[bool] = True
    expression = "1"
    channels: tuple[str, ...] = ()

    def add_offsets(self, chain: SensorChain) -> None:
        """Add the term, times its amplitudes, to its channels."""
        term = chain.terms.get(self.expression) or evaluate_term(self.expression, chain)
        chain.terms[self.expression] = term
        amplitudes = iter(self.values().values())
        for channel in self.channels:
            row = CHANNELS.index(channel)
            reading = chain.gyro[row] if row < 3 else chain.accel[row - 3]
            for column in term:
                amplitude = next(amplitudes)
                if amplitude:
                    reading += amplitude * column


@lru_cache(maxsize=256)
def empirical_class(name: str) -> type[Effect]:
    """Return the class of an empirical effect by name, such as `empirical:gx,gy ~ temperature_rate`.

    Raise ValueError for a name without channels or with a term that is not in the library.
    """
    listed, separator, expression = name.removeprefix(PREFIX).partition(" ~ ")
    channels = tuple(listed.split(","))
    if not name.startswith(PREFIX) or not separator or any(it not in CHANNELS for it in channels):
        raise ValueError(f"{name!r}: write empirical:CHANNEL ~ TERM with a channel of {', '.join(CHANNELS)}")
    suffixes = _suffixes(expression)
    amplitudes = []
    for channel in channels:
        is_gyro = channel.startswith("g")
        unit = f"{'rad/s' if is_gyro else 'm/s²'} per unit of the term"
        scale = _GYRO_AMPLITUDE_SCALE if is_gyro else _ACCEL_AMPLITUDE_SCALE
        amplitudes += [(f"{channel}{suffix}", float, parameter(unit, scale)) for suffix in suffixes]
    kind = make_dataclass(
        "Empirical",
        amplitudes,
        bases=(_Empirical,),
        frozen=True,
        namespace={
            "name": name,
            "expression": expression,
            "channels": channels,
            "has_memory": "temperature_rate" in _split(expression),
        },
    )
    # The term is evaluated once, so that an unknown one is refused here.
    zero = np.zeros((3, 2))
    evaluate_term(expression, SensorChain(np.arange(2.0), zero[0], zero, zero, zero, zero, zero))
    return kind
