"""Effects that have no name: a term of a library added to some channels of a node.

`empirical:gz ~ spin^2*cos(2*theta)` adds to gz what its amplitudes make of the term. The label holds all that
is fixed, the fields are the amplitudes; a periodic term has two of them, for cosine and sine.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import make_dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from hubodo.arrays import Array
from hubodo.effects.base import Chain, Effect, parameter
from hubodo.effects.dependence import temperature_rate

PREFIX = "empirical:"
CHANNELS = ("gx", "gy", "gz", "ax", "ay", "az")
HARMONICS = 6
_GYRO_SCALE, _ACCEL_SCALE = 0.01, 0.1


def _full(chain: Chain, value: Array | float) -> Array:
    return np.broadcast_to(np.asarray(value, float), chain.t.shape)


FACTORS: dict[str, Callable[[Chain], Array]] = {
    "1": lambda chain: np.ones_like(chain.t),
    "t": lambda chain: chain.t,
    "spin": lambda chain: _full(chain, chain.spin),
    "spin^2": lambda chain: _full(chain, chain.spin) ** 2,
    "abs(spin)": lambda chain: np.abs(_full(chain, chain.spin)),
    "speed": lambda chain: _full(chain, chain.speed),
    "speed^2": lambda chain: _full(chain, chain.speed) ** 2,
    "acceleration": lambda chain: _full(chain, chain.acceleration),
    "sign(acceleration)": lambda chain: np.tanh(_full(chain, chain.acceleration) / 0.05),
    "yaw_rate": lambda chain: _full(chain, chain.yaw_rate),
    "abs(yaw_rate)": lambda chain: np.abs(_full(chain, chain.yaw_rate)),
    "temperature": lambda chain: chain.temperature - 25.0,
    "temperature_rate": temperature_rate,
    "fx*fy": lambda chain: chain.force[0] * chain.force[1],
    "fx*fz": lambda chain: chain.force[0] * chain.force[2],
    "fy*fz": lambda chain: chain.force[1] * chain.force[2],
}
_HARMONIC = re.compile(r"cos\((\d+)\*theta\)")
_TONE = re.compile(r"cos\(2\*pi\*([0-9.]+)\*t\)")
_STEP = re.compile(r"step\(t-([0-9.]+)\)")
ALL_HARMONICS = "harmonics(theta)"


def columns(expression: str, chain: Chain) -> list[Array]:
    """The columns, (N,) each, that a term stands for: one; two where periodic; all harmonics: thirteen.

    Raises ValueError for an expression that is not of the library.
    """
    real, periodic = np.ones_like(chain.t), [np.ones_like(chain.t)]
    for factor in _split(expression):
        if factor in FACTORS:
            real = real * FACTORS[factor](chain)
        elif match := _HARMONIC.fullmatch(factor):
            angle = int(match[1]) * _full(chain, chain.angle)
            periodic = [np.cos(angle), np.sin(angle)]
        elif match := _TONE.fullmatch(factor):
            angle = 2.0 * math.pi * float(match[1]) * chain.t
            periodic = [np.cos(angle), np.sin(angle)]
        elif match := _STEP.fullmatch(factor):
            real = real * (chain.t >= float(match[1]))
        elif factor == ALL_HARMONICS:
            once = turn = np.exp(1j * _full(chain, chain.angle))
            periodic = [turn.real.copy(), turn.imag.copy()]
            while len(periodic) < 2 * HARMONICS:
                turn = turn * once
                periodic += [turn.real.copy(), turn.imag.copy()]
        else:
            raise ValueError(
                f"no such term: {factor!r}; known are {', '.join(FACTORS)}, cos(2*theta), step(t-10)"
            )
    for wave in periodic:
        # Of a long log they are large: no second copy.
        wave *= real
    return periodic


def _split(expression: str) -> list[str]:
    """Factors at the stars that stand outside brackets; products of forces are one factor."""
    factors, depth, start = [], 0, 0
    for k, sign in enumerate(expression):
        depth += (sign == "(") - (sign == ")")
        if sign == "*" and depth == 0:
            factors.append(expression[start:k])
            start = k + 1
    factors.append(expression[start:])
    joined: list[str] = []
    for factor in factors:
        if joined and f"{joined[-1]}*{factor}" in FACTORS:
            joined[-1] = f"{joined[-1]}*{factor}"
        else:
            joined.append(factor)
    return joined


def _suffixes(expression: str) -> list[str]:
    """One for each column of a term, as its fields end."""
    factors = _split(expression)
    if ALL_HARMONICS in factors:
        return [f"_{turn}{k}" for k in range(1, HARMONICS + 1) for turn in ("cos", "sin")]
    return ["_cos", "_sin"] if any("cos(" in factor for factor in factors) else [""]


class _Empirical(Effect):
    proportional: ClassVar[bool] = True
    expression = "1"
    channels: tuple[str, ...] = ()

    def offset(self, chain: Chain) -> None:
        """Add the term to its channels."""
        made = chain.terms.get(self.expression) or columns(self.expression, chain)
        chain.terms[self.expression] = made
        values = iter(self.values().values())
        for channel in self.channels:
            row = CHANNELS.index(channel)
            target = chain.gyro[row] if row < 3 else chain.accel[row - 3]
            for column in made:
                amplitude = next(values)
                if amplitude:
                    target += amplitude * column


@lru_cache(maxsize=256)
def empirical(name: str) -> type[Effect]:
    """The effect of a name such as `empirical:gx,gy ~ temperature_rate`.

    Raises ValueError for a name without channels or with a term that is not of the library.
    """
    channels, mark, expression = name.removeprefix(PREFIX).partition(" ~ ")
    rows = tuple(channels.split(","))
    if not name.startswith(PREFIX) or not mark or any(row not in CHANNELS for row in rows):
        raise ValueError(f"{name!r}: write empirical:CHANNEL ~ TERM with a channel of {', '.join(CHANNELS)}")
    suffixes = _suffixes(expression)
    items = []
    for row in rows:
        unit, scale = ("rad/s", _GYRO_SCALE) if row.startswith("g") else ("m/s²", _ACCEL_SCALE)
        per = f"{unit} per unit of the term"
        items += [(f"{row}{suffix}", float, parameter(per, scale)) for suffix in suffixes]
    made = make_dataclass(
        "Empirical",
        items,
        bases=(_Empirical,),
        frozen=True,
        namespace={
            "name": name,
            "expression": expression,
            "channels": rows,
            "remembers": "temperature_rate" in _split(expression),
        },
    )
    nothing = np.zeros(2)
    zero = np.zeros((3, 2))
    columns(expression, Chain(np.arange(2.0), nothing, zero, zero, zero, zero, zero))
    return made
