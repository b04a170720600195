"""Structure that no effect of the vocabulary makes: a sparse look at the residual with a library of terms.

Each term is tried on every channel of a node; what it gains there counts when it pays for its amplitudes and
for having been looked for among so many. The best term of a node competes with the effects that have names.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.optimize import minimize_scalar

from hubodo.arrays import Array
from hubodo.effects.base import SensorChain
from hubodo.effects.empirical import ALL_HARMONICS, FACTORS, PREFIX, columns, empirical
from hubodo.gap.problem.problem import CHANNELS, NodeData
from hubodo.gap.process_noise.point import Point
from hubodo.gap.process_noise.window_sums import winsorised
from hubodo.gap.state.terms import ModelTerm
from hubodo.model.forward import NodeReading

_PERIODIC = [f"cos({k}*theta)" for k in range(1, 7)] + [
    "spin^2*cos(1*theta)",
    "spin^2*cos(2*theta)",
    "spin*cos(1*theta)",
    "yaw_rate*cos(1*theta)",
    ALL_HARMONICS,
    f"spin^2*{ALL_HARMONICS}",
]
_PRODUCTS = ["spin*acceleration", "spin*yaw_rate", "spin^2*spin"]
# A constant is a bias, which has a name.
LIBRARY: tuple[str, ...] = (*(name for name in FACTORS if name != "1"), *_PRODUCTS, *_PERIODIC)
# What a gyro may answer has a name there.
_GYRO_NAMED = ("temperature",)
# Seconds over which scores are added up before their scatter is taken.
_BLOCK = 4.0
_TONE_ABOVE = 0.2


@dataclass(frozen=True)
class Structure:
    """A term on some channels of a node.

    gain: of ln likelihood, over its channels. evidence: less what it costs. shares: gain of each channel.
    """

    term: ModelTerm
    expression: str
    channels: tuple[str, ...]
    gain: float
    evidence: float
    shares: tuple[float, ...]


def unlisted(point: Point) -> list[Structure]:
    """For each node the terms that pay for themselves, the best first."""
    made: list[Structure] = []
    for name, residual in point.mean_residuals.items():
        node = residual.node
        chain = scene(node, point.state.readings[name])
        weight = np.where(residual.noise.fresh & ~node.clipped, 1.0 / residual.noise.found, 0.0)
        z = winsorised((residual.value - point.of_inputs[name]) * weight)
        present = {effect.name for effect in residual.effects}
        edges = block_edges(node.t)
        fixed = [*LIBRARY, *_tones(node, z), *_steps(node, z)]
        for expression in fixed:
            if not node.on_wheel and "theta" in expression:
                continue
            found = _tried(node, chain, expression, z, weight, edges)
            if found is not None and found.term.effect.name not in present:
                made.append(found)
    return sorted(made, key=lambda it: -it.evidence)


def block_edges(t: Array) -> NDArray[np.intp]:
    """First samples of blocks, of times t, (N,) s."""
    return np.unique(np.searchsorted(t, np.arange(t[0], t[-1], _BLOCK)))


def scene(node: NodeData, reading: NodeReading) -> SensorChain:
    """What terms are made of: the model's own wheel angle, spin, forces and the vehicle's motion."""
    body, rolling = reading.body, reading.rolling
    zero = np.zeros((3, len(node.t)))
    chain = SensorChain(body.t, body.temperature, zero, zero, reading.accel, zero, zero)
    node.forward.set_motion(chain, body, rolling)
    return chain


def _tried(
    node: NodeData, chain: SensorChain, expression: str, z: Array, weight: Array, edges: NDArray[np.intp]
) -> Structure | None:
    """The term on those channels of the node where it pays. edges: first samples of blocks."""
    made = np.stack(columns(expression, chain))
    size = np.sqrt([[np.mean(column**2)] for column in made])
    if not np.all(size > 0.0):
        return None
    made /= size
    weighted = np.empty_like(made)
    channels, shares, paid = [], [], 0.0
    cost = 0.5 * len(made) * log(len(node.t) / 4.0)
    for row in np.flatnonzero(node.used):
        if row < 3 and expression in _GYRO_NAMED:
            continue
        gain = _gain(np.multiply(made, weight[row], out=weighted), z[row], edges, cost + 3.0)
        if gain > 0.0:
            channels.append(CHANNELS[row])
            shares.append(gain)
            paid += gain - cost
    if not channels:
        return None
    effect = empirical(f"{PREFIX}{','.join(channels)} ~ {expression}")()
    # Looked for among the terms; a tone or a step also among the frequencies or times it could have.
    searched = log(len(LIBRARY) + 2.0)
    if expression.startswith(("cos(2*pi", "step")):
        searched += log(len(node.t) / 2.0)
    return Structure(
        ModelTerm(effect, node.name), expression, tuple(channels), sum(shares), paid - searched, tuple(shares)
    )


def _gain(made: Array, z: Array, edges: NDArray[np.intp], least: float) -> float:
    """Gain of ln likelihood, less where the scores of blocks scatter more than independent samples would.

    Zero where that is not more than `least`.
    """
    inner = made @ made.T
    values, vectors = np.linalg.eigh(inner)
    if values[0] <= 1e-9 * values[-1]:
        return 0.0
    turned = (vectors / np.sqrt(values)).T
    if 0.5 * float(np.sum((turned @ (made @ z)) ** 2)) <= least:
        return 0.0
    half = turned @ made
    along = half @ z
    plain = 0.5 * float(along @ along)
    half *= z - along @ half
    scores = np.add.reduceat(half, edges, axis=1)
    gain = plain / max(1.0, float(np.sum(scores**2)) / len(half))
    return gain if gain > least else 0.0


def _tones(node: NodeData, z: Array) -> list[str]:
    """The strongest line in the spectrum of each channel, where it stands out, refined between the bins."""
    found = []
    grid = np.linspace(node.t[0], node.t[-1], len(node.t))
    step, size = float(grid[1] - grid[0]), next_fast_len(2 * len(grid), real=True)
    for row in np.flatnonzero(node.used):
        even = np.interp(grid, node.t, z[row])
        power = np.abs(np.fft.rfft(even, size)) ** 2 / len(even)
        frequency = np.fft.rfftfreq(size, step)
        power[frequency < _TONE_ABOVE] = 0.0
        at = int(np.argmax(power))
        if power[at] > log(len(even)) + 8.0:
            found.append(
                f"cos(2*pi*{refined(node.t, z[row], frequency[at], 0.5 / (grid[-1] - grid[0])):.6f}*t)"
            )
    return sorted(set(found))


def refined(t: Array, z: Array, frequency: float, width: float) -> float:
    def less(f: float) -> float:
        return -float(abs(np.vdot(np.exp(2j * np.pi * f * t), z)))

    best = minimize_scalar(less, bounds=(frequency - width, frequency + width), method="bounded")
    return float(best.x)


def _steps(node: NodeData, z: Array) -> list[str]:
    """The time at which each channel changes its level most, where that stands out."""
    found = []
    for row in np.flatnonzero(node.used):
        total = np.cumsum(z[row])
        count = np.arange(1, len(total) + 1)
        whole = total[-1]
        inside = slice(50, -50)
        rise = (total - whole * count / len(total)) ** 2 / (
            count * (1.0 - count / (len(total) + 1e-9)) + 1e-9
        )
        at = int(np.argmax(rise[inside])) + 50
        if 0.5 * rise[at] > log(len(total)) + 6.0:
            found.append(f"step(t-{node.t[min(at + 1, len(total) - 1)]:.2f})")
    return sorted(set(found))
