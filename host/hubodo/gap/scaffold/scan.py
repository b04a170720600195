"""Every dependence on every target of every node, as the linear model sees it: which are worth a fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import log

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects.base import SensorChain
from hubodo.effects.dependence import pulse
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

# Hz below which a tone is the drive itself.
_MIN_SCAN_TONE_HZ = 0.2
# Samples at either end where no step is looked for; sectors of a turn, and widths, rad, of a bump.
_STEP_MARGIN_SAMPLES, _BUMP_SECTORS, _BUMP_WIDTHS = 50, 180, (0.08, 0.16, 0.32)
_TRIAD_CHANNELS = (("gx", "gy", "gz"), ("ax", "ay", "az"))


@dataclass(frozen=True)
class Dependence:
    """A shape on some targets. scope: a node, or all. evidence: gain of ln likelihood less what it costs."""

    shape: Shape
    targets: tuple[Target, ...]
    scope: str
    evidence: float


@dataclass(frozen=True)
class _TargetData:
    """One target of one node: along (N,) and square (N,) make scores and information of a column of it.

    edges: first samples of blocks.
    """

    node: NodeData
    chain: SensorChain
    target: Target
    along: Array
    square: Array
    edges: NDArray[np.intp]


def scan_dependences(point: Evaluation) -> list[Dependence]:
    """What pays for itself, the best first."""
    views = [view for name in point.mean_residuals for view in _list_target_data(point, name)]
    nodes = {view.node.name for view in views}
    made: list[Dependence] = []
    for shape in list_shapes():
        made += _try_shape(shape, [view for view in views if view.target is not TIME_STAMP], len(nodes))
    for view in views:
        made += _try_located_shapes(view)
    return sorted(made, key=lambda it: -it.evidence)


def _list_target_data(point: Evaluation, name: str) -> Iterator[_TargetData]:
    residual = point.mean_residuals[name]
    node, chain = residual.node, build_chain(residual.node, point.state.predictions[name])
    weight = np.where(residual.noise.is_new & ~node.clipped, 1.0 / residual.noise.sigma, 0.0)
    weight = weight * node.used[:, None]
    edges = block_edges(node.t)
    z = winsorise((residual.value - point.input_noise_residuals[name]) * weight)
    for target in (*CHANNELS, *VEHICLE_AXES):
        rows = [row for row, _ in target.rows]
        if (target.needs_wheel and not node.on_wheel) or not node.used[rows].all():
            continue
        known = {"np": np, "chain": chain, **HELPERS}
        # Nothing but the library's own expressions is read.
        felt = (
            np.stack([np.broadcast_to(eval(by, known), node.t.shape) for _, by in target.rows]) * weight[rows]
        )
        yield _TargetData(node, chain, target, np.sum(felt * z[rows], axis=0), np.sum(felt**2, axis=0), edges)
    felt = point.state.delay_columns[name] * weight
    yield _TargetData(node, chain, TIME_STAMP, np.sum(felt * z, axis=0), np.sum(felt**2, axis=0), edges)


def _try_shape(shape: Shape, views: Sequence[_TargetData], nodes: int) -> Iterator[Dependence]:
    """A shape on each target, on those of a triad where it pays, and on all nodes alike."""
    by_target: dict[Target, list[tuple[_TargetData, Array, Array]]] = {}
    paying: dict[tuple[str, int], list[tuple[Target, float]]] = {}
    of_node: dict[str, Array] = {}
    for view in views:
        if shape.needs_wheel and not view.node.on_wheel:
            continue
        columns = of_node.get(view.node.name)
        if columns is None:
            columns = of_node[view.node.name] = shape.columns(view.chain)
        score, inner, tempering = _score_columns(columns, view)
        by_target.setdefault(view.target, []).append((view, score, inner))
        evidence = _gain(score, inner) / tempering - _description_cost(shape, view)
        if evidence > 0.0:
            yield Dependence(shape, (view.target,), view.node.name, evidence)
            for which, names in enumerate(_TRIAD_CHANNELS):
                if view.target.name in names and view.target in CHANNELS:
                    paying.setdefault((view.node.name, which), []).append((view.target, evidence))
    for (node, _), found in paying.items():
        if len(found) > 1:
            together = sum(evidence for _, evidence in found)
            yield Dependence(shape, tuple(target for target, _ in found), node, together)
    for target, parts in by_target.items():
        # What all nodes have alike is of the vehicle: along az they would differ where they face two ways.
        if shape.is_shareable and nodes > 1 and len(parts) == nodes and target.name != "az":
            score, inner = np.sum([part[1] for part in parts], 0), np.sum([part[2] for part in parts], 0)
            evidence = _gain(score, inner) - _description_cost(shape, parts[0][0])
            if evidence > 0.0:
                yield Dependence(shape, (target,), ALL, evidence)


def _score_columns(columns: Array, view: _TargetData) -> tuple[Array, Array, float]:
    """Score, information, and by how much the scores of blocks scatter more than independent ones."""
    inner = (columns * view.square) @ columns.T
    along = columns * view.along
    score = along.sum(axis=1)
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    scaled = inner / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < 1e-6:
        return score, inner, 1.0
    fitted = np.linalg.solve(scaled, score / size) / size
    left = (
        np.add.reduceat(along - columns * (view.square * (fitted @ columns)), view.edges, axis=1)
        / size[:, None]
    )
    spread = np.trace(np.linalg.solve(scaled, left @ left.T)) / len(columns)
    return score, inner, max(1.0, float(spread))


def _gain(score: Array, inner: Array) -> float:
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    scaled = inner / np.outer(size, size)
    if not np.all(np.diag(inner) > 0.0) or np.linalg.eigvalsh(scaled)[0] < 1e-6:
        return 0.0
    return 0.5 * float(score / size @ np.linalg.solve(scaled, score / size))


def _description_cost(shape: Shape, view: _TargetData) -> float:
    """Of its amplitudes and places, and of having been looked for."""
    free = len(shape.amplitudes) + len(shape.parameters)
    return 0.5 * free * log(len(view.node.t) / 4.0) + 5.0


def _try_located_shapes(view: _TargetData) -> Iterator[Dependence]:
    """Tone, step and bump where they fit this target best."""
    found: list[Shape] = []
    if view.target is not TIME_STAMP:
        found += _find_tone(view)
        if view.node.on_wheel:
            found += [_find_bump(view, weight) for weight in ("1.0", "chain.spin**2")]
    for shape in found:
        yield from (it for it in _try_shape(shape, [view], 0) if len(it.targets) == 1)
    at, gain = _find_step(view)
    evidence = gain - _description_cost(build_step(at), view)
    if evidence > 0.0:
        yield Dependence(build_step(at), (view.target,), view.node.name, evidence)


def _find_tone(view: _TargetData) -> Iterator[Shape]:
    t, z = view.node.t, view.along / np.sqrt(max(float(np.mean(view.square)), 1e-300))
    grid = np.linspace(t[0], t[-1], len(t))
    power = np.abs(np.fft.rfft(np.interp(grid, t, z), 2 * len(t))) ** 2
    frequency = np.fft.rfftfreq(2 * len(t), float(grid[1] - grid[0]))
    power[frequency < _MIN_SCAN_TONE_HZ] = 0.0
    duration = float(t[-1] - t[0])
    yield build_tone(
        refine_frequency(t, z, float(frequency[int(np.argmax(power))]), 0.5 / duration), duration
    )


def _find_step(view: _TargetData) -> tuple[float, float]:
    """When, s, and the gain of another level from there on over one level for all."""
    before, weight = np.cumsum(view.along), np.cumsum(view.square)
    inside = slice(_STEP_MARGIN_SAMPLES, -_STEP_MARGIN_SAMPLES)
    left, right = weight[inside], weight[-1] - weight[inside]
    gains = before[inside] ** 2 / np.maximum(left, 1e-300)
    gains = gains + (before[-1] - before[inside]) ** 2 / np.maximum(right, 1e-300)
    at = int(np.argmax(gains))
    gain = 0.5 * float(gains[at] - before[-1] ** 2 / max(float(weight[-1]), 1e-300))
    return float(view.node.t[_STEP_MARGIN_SAMPLES + at + 1]), gain


def _find_bump(view: _TargetData, weight: str) -> Shape:
    """Scores and information in sectors of a turn, smoothed with each width, are those of every bump."""
    by = np.broadcast_to(eval(weight, {"chain": view.chain}), view.node.t.shape)
    sector = (np.asarray(view.chain.angle) % (2.0 * np.pi) / (2.0 * np.pi) * _BUMP_SECTORS).astype(
        int
    ) % _BUMP_SECTORS
    score = np.bincount(sector, view.along * by, _BUMP_SECTORS)
    inner = np.bincount(sector, view.square * by**2, _BUMP_SECTORS)
    centre = (np.arange(_BUMP_SECTORS) + 0.5) * 2.0 * np.pi / _BUMP_SECTORS
    best = (0.0, 0.0, _BUMP_WIDTHS[0])
    for width in _BUMP_WIDTHS:
        bell = pulse(centre[:, None] - centre, width)
        gains = (bell @ score) ** 2 / np.maximum(bell**2 @ inner, 1e-300)
        best = max(best, (float(gains.max()), float(centre[int(np.argmax(gains))]), width))
    return build_bump(best[1], best[2], weight)
