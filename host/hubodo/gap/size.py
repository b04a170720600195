"""How large the gap is: residuals in units of the noise that the model declares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.gap.linearised import Weights
from hubodo.gap.noise import declared_noise
from hubodo.gap.problem import NodeData, Problem
from hubodo.gap.state import State, effects_of, predict, stacked
from hubodo.gap.walk import smoothed, walked
from hubodo.gap.wheel_phase import WINDOW, windows
from hubodo.model.effects import BY_NAME
from hubodo.model.frames import Array

Masks = Mapping[str, NDArray[np.bool_]]


@dataclass(frozen=True)
class Trace:
    """One node: what it read beyond the model, the noise declared, and what the model reads, (6, N)."""

    node: NodeData
    residual: Array
    declared: Array
    predicted: Array


def traces(problem: Problem, state: State, weights: Weights) -> dict[str, Trace]:
    """The residual of each node at a state, with what wanders at random followed as far as it is modelled."""
    readings, effects = predict(problem, state), effects_of(problem, state.terms)
    made = {}
    for node in problem.nodes:
        own = effects[node.name]
        predicted = stacked(readings[node.name])
        if BY_NAME["sample_repeat"] in own:
            fresh = weights.noise[node.name].fresh
            predicted = predicted[:, np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))]
        rest = node.y - predicted
        drift = sum(effect.drift() for effect in own.values())
        if drift > 0.0:
            wander = _followed(node, rest, weights, drift)
            predicted[:3] += wander
            rest[:3] -= wander
        declared = declared_noise(problem, node, readings[node.name], own.values())
        made[node.name] = Trace(node, rest, declared, predicted)
    return made


def gap(traced: Mapping[str, Trace], inside: Masks | None = None) -> float:
    """Root mean square of residual over declared noise, all channels measured; `inside`: samples."""
    total, count = 0.0, 0
    for name, trace in traced.items():
        at = slice(None) if inside is None else inside[name]
        z = (trace.residual / trace.declared)[trace.node.used][:, at]
        total, count = total + float(np.sum(z**2)), count + z.size
    return float(np.sqrt(total / count)) if count else float("nan")


def floor(traced: Mapping[str, Trace], weights: Weights) -> float:
    """The gap that would be left if nothing but noise were: its scatter from sample to sample."""
    total, count = 0.0, 0
    for name, trace in traced.items():
        spare = weights.noise[name].found[trace.node.used] / trace.declared[trace.node.used]
        total, count = total + float(np.sum(spare**2)), count + spare.size
    return float(np.sqrt(total / count)) if count else float("nan")


def _followed(node: NodeData, rest: Array, weights: Weights, drift: float) -> Array:
    """(3, N): a walk of intensity drift, (rad/s)²/s, through the window means of the gyros' residual."""
    edges = windows(node.t)
    middle = np.add.reduceat(node.t, edges[:-1]) / np.diff(edges)
    noise = weights.noise[node.name]
    made = np.empty((3, len(node.t)))
    for row in range(3):
        weight = noise.fresh / noise.found[row] ** 2
        information = np.maximum(np.add.reduceat(weight, edges[:-1]), 1e-12)
        mean = np.add.reduceat(weight * rest[row], edges[:-1]) / information
        steps = np.diff(middle)
        walk = walked(mean, 1.0 / information, steps, drift, start=drift * WINDOW)
        made[row] = np.interp(node.t, middle, smoothed(walk, steps, drift))
    return made
