"""Scan of every dependence on every target of every node in the linear model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects.dependence import pulse
from hubodo.effects.sensor_chain import SensorChain
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.window_sums import winsorise
from hubodo.gap.scaffold.library import (
    CHANNELS,
    HELPERS,
    TIME_STAMP,
    VEHICLE_AXES,
    Shape,
    Target,
    build_bump,
    build_step,
    build_tone,
    list_shapes,
)
from hubodo.gap.screen.unnamed_terms import block_edges, build_chain, refine_frequency
from hubodo.gap.state.terms import ALL

# Hz, lowest frequency of a tone; slower ones may be the drive itself.
_MIN_SCAN_TONE_HZ = 0.2
# Samples at either end without a step; sectors of a revolution; widths of a bump, rad.
_STEP_MARGIN_SAMPLES, _BUMP_SECTORS, _BUMP_WIDTHS = 50, 180, (0.08, 0.16, 0.32)
_TRIAD_CHANNELS = (("gx", "gy", "gz"), ("ax", "ay", "az"))


@dataclass(frozen=True)
class Dependence:
    """A shape applied to some targets, with its evidence.

    scope: name of a node, or `all`
    evidence: gain of ln likelihood minus its cost
    """

    shape: Shape
    targets: tuple[Target, ...]
    scope: str
    evidence: float


@dataclass(frozen=True)
class _TargetData:
    """Data of one target of one node; a column c has score Σ along · c and information Σ square · c².

    edges: first samples of blocks
    """

    node: NodeData
    chain: SensorChain
    target: Target
    along: Array
    square: Array
    edges: NDArray[np.intp]


def scan_dependences(evaluation: Evaluation) -> list[Dependence]:
    """Scan all dependences and return those with positive evidence, the best first."""
    target_data = [data for name in evaluation.mean_residuals for data in _list_target_data(evaluation, name)]
    nodes = {data.node.name for data in target_data}
    dependences: list[Dependence] = []
    for shape in list_shapes():
        dependences += _try_shape(
            shape, [data for data in target_data if data.target is not TIME_STAMP], len(nodes)
        )
    for data in target_data:
        dependences += _try_located_shapes(data)
    return sorted(dependences, key=lambda item: -item.evidence)


def _list_target_data(evaluation: Evaluation, name: str) -> Iterator[_TargetData]:
    residual = evaluation.mean_residuals[name]
    node, chain = residual.node, build_chain(residual.node, evaluation.state.predictions[name])
    weight = np.where(residual.noise.is_new & ~node.is_saturated, 1.0 / residual.noise.sigma, 0.0)
    weight = weight * node.used[:, None]
    edges = block_edges(node.t)
    z = winsorise((residual.value - evaluation.input_noise_residuals[name]) * weight)
    for target in (*CHANNELS, *VEHICLE_AXES):
        rows = [row for row, _ in target.rows]
        if (target.needs_wheel and not node.on_wheel) or not node.used[rows].all():
            continue
        names = {"np": np, "chain": chain, **HELPERS}
        # Only the library's own expressions are evaluated.
        columns = (
            np.stack([np.broadcast_to(eval(factor, names), node.t.shape) for _, factor in target.rows])
            * weight[rows]
        )
        yield _TargetData(
            node, chain, target, np.sum(columns * z[rows], axis=0), np.sum(columns**2, axis=0), edges
        )
    columns = evaluation.state.delay_columns[name] * weight
    yield _TargetData(node, chain, TIME_STAMP, np.sum(columns * z, axis=0), np.sum(columns**2, axis=0), edges)


def _try_shape(shape: Shape, target_data: Sequence[_TargetData], nodes: int) -> Iterator[Dependence]:
    """Yield a shape on each target, on several targets of a triad, and on all nodes in common."""
    by_target: dict[Target, list[tuple[_TargetData, Array, Array]]] = {}
    paying_of_triad: dict[tuple[str, int], list[tuple[Target, float]]] = {}
    columns_by_node: dict[str, Array] = {}
    for data in target_data:
        if shape.needs_wheel and not data.node.on_wheel:
            continue
        columns = columns_by_node.get(data.node.name)
        if columns is None:
            columns = columns_by_node[data.node.name] = shape.columns(data.chain)
        score, information, tempering = _score_columns(columns, data)
        by_target.setdefault(data.target, []).append((data, score, information))
        evidence = _gain(score, information) / tempering - _description_cost(shape, data)
        if evidence > 0.0:
            yield Dependence(shape, (data.target,), data.node.name, evidence)
            for triad, names in enumerate(_TRIAD_CHANNELS):
                if data.target.name in names and data.target in CHANNELS:
                    paying_of_triad.setdefault((data.node.name, triad), []).append((data.target, evidence))
    for (node, _), targets_and_evidence in paying_of_triad.items():
        if len(targets_and_evidence) > 1:
            total = sum(evidence for _, evidence in targets_and_evidence)
            yield Dependence(shape, tuple(target for target, _ in targets_and_evidence), node, total)
    for target, entries in by_target.items():
        # A dependence common to all nodes has its cause in the vehicle; not in az, as nodes face both ways.
        if shape.is_shareable and nodes > 1 and len(entries) == nodes and target.name != "az":
            score, information = (
                np.sum([entry[1] for entry in entries], 0),
                np.sum([entry[2] for entry in entries], 0),
            )
            evidence = _gain(score, information) - _description_cost(shape, entries[0][0])
            if evidence > 0.0:
                yield Dependence(shape, (target,), ALL, evidence)


def _score_columns(columns: Array, data: _TargetData) -> tuple[Array, Array, float]:
    """Return score, information, and the ratio of block score scatter to that of independent samples."""
    information = (columns * data.square) @ columns.T
    scores = columns * data.along
    score = scores.sum(axis=1)
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(scale, scale)
    if np.linalg.eigvalsh(scaled)[0] < 1e-6:
        return score, information, 1.0
    fitted = np.linalg.solve(scaled, score / scale) / scale
    block_scores = (
        np.add.reduceat(scores - columns * (data.square * (fitted @ columns)), data.edges, axis=1)
        / scale[:, None]
    )
    spread = np.trace(np.linalg.solve(scaled, block_scores @ block_scores.T)) / len(columns)
    return score, information, max(1.0, float(spread))


def _gain(score: Array, information: Array) -> float:
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information / np.outer(scale, scale)
    if not np.all(np.diag(information) > 0.0) or np.linalg.eigvalsh(scaled)[0] < 1e-6:
        return 0.0
    return 0.5 * float(score / scale @ np.linalg.solve(scaled, score / scale))


def _description_cost(shape: Shape, data: _TargetData) -> float:
    """Return the Occam penalty for amplitudes, parameters and the number of dependences tried."""
    n_free = len(shape.amplitudes) + len(shape.parameters)
    return 0.5 * n_free * log(len(data.node.t) / 4.0) + 5.0


def _try_located_shapes(data: _TargetData) -> Iterator[Dependence]:
    """Yield tone, step and bump at their best place for this target."""
    located: list[Shape] = []
    if data.target is not TIME_STAMP:
        located += _find_tone(data)
        if data.node.on_wheel:
            located += [_find_bump(data, weight) for weight in ("1.0", "chain.spin**2")]
    for shape in located:
        yield from (dependence for dependence in _try_shape(shape, [data], 0) if len(dependence.targets) == 1)
    time, gain = _find_step(data)
    evidence = gain - _description_cost(build_step(time), data)
    if evidence > 0.0:
        yield Dependence(build_step(time), (data.target,), data.node.name, evidence)


def _find_tone(data: _TargetData) -> Iterator[Shape]:
    t, z = data.node.t, data.along / np.sqrt(max(float(np.mean(data.square)), 1e-300))
    grid = np.linspace(t[0], t[-1], len(t))
    power = np.abs(np.fft.rfft(np.interp(grid, t, z), 2 * len(t))) ** 2
    frequency = np.fft.rfftfreq(2 * len(t), float(grid[1] - grid[0]))
    power[frequency < _MIN_SCAN_TONE_HZ] = 0.0
    duration = float(t[-1] - t[0])
    yield build_tone(
        refine_frequency(t, z, float(frequency[int(np.argmax(power))]), 0.5 / duration), duration
    )


def _find_step(data: _TargetData) -> tuple[float, float]:
    """Return the time, s, of the best level change, and its gain over a constant level."""
    cumulative, weight = np.cumsum(data.along), np.cumsum(data.square)
    interior = slice(_STEP_MARGIN_SAMPLES, -_STEP_MARGIN_SAMPLES)
    left, right = weight[interior], weight[-1] - weight[interior]
    gains = cumulative[interior] ** 2 / np.maximum(left, 1e-300)
    gains = gains + (cumulative[-1] - cumulative[interior]) ** 2 / np.maximum(right, 1e-300)
    best = int(np.argmax(gains))
    gain = 0.5 * float(gains[best] - cumulative[-1] ** 2 / max(float(weight[-1]), 1e-300))
    return float(data.node.t[_STEP_MARGIN_SAMPLES + best + 1]), gain


def _find_bump(data: _TargetData, weight: str) -> Shape:
    """Return the best bump, from scores and information per sector of a turn, for each width."""
    factor = np.broadcast_to(eval(weight, {"chain": data.chain}), data.node.t.shape)
    sector = (np.asarray(data.chain.angle) % (2.0 * np.pi) / (2.0 * np.pi) * _BUMP_SECTORS).astype(
        int
    ) % _BUMP_SECTORS
    score = np.bincount(sector, data.along * factor, _BUMP_SECTORS)
    information = np.bincount(sector, data.square * factor**2, _BUMP_SECTORS)
    centre = (np.arange(_BUMP_SECTORS) + 0.5) * 2.0 * np.pi / _BUMP_SECTORS
    best = (0.0, 0.0, _BUMP_WIDTHS[0])
    for width in _BUMP_WIDTHS:
        pulses = pulse(centre[:, None] - centre, width)
        gains = (pulses @ score) ** 2 / np.maximum(pulses**2 @ information, 1e-300)
        best = max(best, (float(gains.max()), float(centre[int(np.argmax(gains))]), width))
    return build_bump(best[1], best[2], weight)
