"""Unnamed terms: a sparse search of the residual with a library of basis functions.

Each term is tried on every channel of a node. Its gain is penalised for its amplitudes and for the number of
terms tried. The best term of each node competes with the effects of the vocabulary (after Brunton, Proctor
and Kutz 2016).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.optimize import minimize_scalar

from hubodo.arrays import Array
from hubodo.effects.empirical import ALL_HARMONICS, FACTORS, PREFIX, empirical_class, evaluate_term
from hubodo.effects.sensor_chain import SensorChain
from hubodo.gap.problem.problem import CHANNELS, NodeData
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.window_sums import winsorise
from hubodo.gap.state.terms import ModelTerm
from hubodo.model.forward import NodeReading

_PERIODIC_TERMS = [f"cos({k}*theta)" for k in range(1, 7)] + [
    "spin^2*cos(1*theta)",
    "spin^2*cos(2*theta)",
    "spin*cos(1*theta)",
    "yaw_rate*cos(1*theta)",
    ALL_HARMONICS,
    f"spin^2*{ALL_HARMONICS}",
]
_PRODUCT_TERMS = ["spin*acceleration", "spin*yaw_rate", "spin^2*spin"]
# Factors and products of the library. A constant is missing because a bias is a named effect.
TERM_LIBRARY: tuple[str, ...] = (
    *(name for name in FACTORS if name != "1"),
    *_PRODUCT_TERMS,
    *_PERIODIC_TERMS,
)
# Factors that are effects of the vocabulary on gyro channels.
_NAMED_ON_GYROS = ("temperature",)
# s; blocks of scores whose scatter tempers the gain.
_SCORE_BLOCK = 4.0
_MIN_TONE_HZ = 0.2


@dataclass(frozen=True)
class UnnamedTerm:
    """A library term on some channels of a node.

    gain: gain of ln likelihood, summed over its channels
    evidence: gain minus the cost of its amplitudes and of the search
    channel_gains: gain of each channel
    """

    term: ModelTerm
    expression: str
    channels: tuple[str, ...]
    gain: float
    evidence: float
    channel_gains: tuple[float, ...]


def find_unnamed_terms(evaluation: Evaluation) -> list[UnnamedTerm]:
    """Return the terms of each node with positive evidence, the best first."""
    terms: list[UnnamedTerm] = []
    for name, residual in evaluation.mean_residuals.items():
        node = residual.node
        chain = build_chain(node, evaluation.state.predictions[name])
        weight = np.where(residual.noise.is_new & ~node.is_saturated, 1.0 / residual.noise.sigma, 0.0)
        z = winsorise((residual.value - evaluation.input_noise_residuals[name]) * weight)
        present = {effect.name for effect in residual.effects}
        edges = block_edges(node.t)
        expressions = [*TERM_LIBRARY, *_find_tones(node, z), *_find_steps(node, z)]
        for expression in expressions:
            if not node.on_wheel and "theta" in expression:
                continue
            term = _fit_term(node, chain, expression, z, weight, edges)
            if term is not None and term.term.effect.name not in present:
                terms.append(term)
    return sorted(terms, key=lambda item: -item.evidence)


def block_edges(t: Array) -> NDArray[np.intp]:
    """Return the index of the first sample of each block of times t, (N,) s."""
    return np.unique(np.searchsorted(t, np.arange(t[0], t[-1], _SCORE_BLOCK)))


def build_chain(node: NodeData, reading: NodeReading) -> SensorChain:
    """Return the variables of library terms: wheel angle, spin, specific force, vehicle motion."""
    body, rolling = reading.body, reading.rolling
    zero = np.zeros((3, len(node.t)))
    chain = SensorChain(body.t, body.temperature, zero, zero, reading.accel, zero, zero)
    node.forward.set_motion(chain, body, rolling)
    return chain


def _fit_term(
    node: NodeData, chain: SensorChain, expression: str, z: Array, weight: Array, edges: NDArray[np.intp]
) -> UnnamedTerm | None:
    """Fit a term to the channels of a node on which it gains enough; `edges`: first samples of blocks."""
    basis = np.stack(evaluate_term(expression, chain))
    size = np.sqrt([[np.mean(column**2)] for column in basis])
    if not np.all(size > 0.0):
        return None
    basis /= size
    weighted = np.empty_like(basis)
    channels, channel_gains, net_gain = [], [], 0.0
    cost = 0.5 * len(basis) * log(len(node.t) / 4.0)
    for row in np.flatnonzero(node.used):
        if row < 3 and expression in _NAMED_ON_GYROS:
            continue
        gain = _tempered_gain(np.multiply(basis, weight[row], out=weighted), z[row], edges, cost + 3.0)
        if gain > 0.0:
            channels.append(CHANNELS[row])
            channel_gains.append(gain)
            net_gain += gain - cost
    if not channels:
        return None
    effect = empirical_class(f"{PREFIX}{','.join(channels)} ~ {expression}")()
    # Penalty for the number of terms, and of possible frequencies of a tone or times of a step.
    searched = log(len(TERM_LIBRARY) + 2.0)
    if expression.startswith(("cos(2*pi", "step")):
        searched += log(len(node.t) / 2.0)
    return UnnamedTerm(
        ModelTerm(effect, node.name),
        expression,
        tuple(channels),
        sum(channel_gains),
        net_gain - searched,
        tuple(channel_gains),
    )


def _tempered_gain(columns: Array, z: Array, edges: NDArray[np.intp], minimum: float) -> float:
    """Return the gain of ln likelihood, divided by the excess scatter of block scores.

    Returns 0 if the gain is not above `minimum`.
    """
    gram = columns @ columns.T
    values, vectors = np.linalg.eigh(gram)
    if values[0] <= 1e-9 * values[-1]:
        return 0.0
    whitening = (vectors / np.sqrt(values)).T
    if 0.5 * float(np.sum((whitening @ (columns @ z)) ** 2)) <= minimum:
        return 0.0
    whitened = whitening @ columns
    coefficients = whitened @ z
    untempered = 0.5 * float(coefficients @ coefficients)
    whitened *= z - coefficients @ whitened
    scores = np.add.reduceat(whitened, edges, axis=1)
    gain = untempered / max(1.0, float(np.sum(scores**2)) / len(whitened))
    return gain if gain > minimum else 0.0


def _find_tones(node: NodeData, z: Array) -> list[str]:
    """Return the strongest spectral line of each channel that stands out, refined between the bins."""
    expressions = []
    grid = np.linspace(node.t[0], node.t[-1], len(node.t))
    step, size = float(grid[1] - grid[0]), next_fast_len(2 * len(grid), real=True)
    for row in np.flatnonzero(node.used):
        resampled = np.interp(grid, node.t, z[row])
        power = np.abs(np.fft.rfft(resampled, size)) ** 2 / len(resampled)
        frequency = np.fft.rfftfreq(size, step)
        power[frequency < _MIN_TONE_HZ] = 0.0
        peak = int(np.argmax(power))
        if power[peak] > log(len(resampled)) + 8.0:
            tone = refine_frequency(node.t, z[row], frequency[peak], 0.5 / (grid[-1] - grid[0]))
            expressions.append(f"cos(2*pi*{tone:.6f}*t)")
    return sorted(set(expressions))


def refine_frequency(t: Array, z: Array, frequency: float, half_width: float) -> float:
    """Return the frequency, Hz, of the strongest tone within `half_width` of a frequency."""

    def negative_amplitude(f: float) -> float:
        return -float(abs(np.vdot(np.exp(2j * np.pi * f * t), z)))

    best = minimize_scalar(
        negative_amplitude, bounds=(frequency - half_width, frequency + half_width), method="bounded"
    )
    return float(best.x)


def _find_steps(node: NodeData, z: Array) -> list[str]:
    """Return the time of the largest change of level of each channel that stands out."""
    expressions = []
    for row in np.flatnonzero(node.used):
        total = np.cumsum(z[row])
        count = np.arange(1, len(total) + 1)
        sum_of_all = total[-1]
        inside = slice(50, -50)
        rise = (total - sum_of_all * count / len(total)) ** 2 / (
            count * (1.0 - count / (len(total) + 1e-9)) + 1e-9
        )
        largest = int(np.argmax(rise[inside])) + 50
        if 0.5 * rise[largest] > log(len(total)) + 6.0:
            expressions.append(f"step(t-{node.t[min(largest + 1, len(total) - 1)]:.2f})")
    return sorted(set(expressions))
