"""How large the gap is: residuals in units of the noise that the model declares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hubodo.arrays import Array
from hubodo.effects import BY_NAME
from hubodo.gap.noise import input_noise, sensor_noise
from hubodo.gap.problem import NodeData, Problem
from hubodo.gap.state import State, effects_of, predict, stacked
from hubodo.gap.wander import Weights, wandered
from hubodo.model.forward import Start

Masks = Mapping[str, NDArray[np.bool_]]


@dataclass(frozen=True)
class Trace:
    """One node, (6, N) each: what it read beyond the model, the noise declared, that of the inputs in it, and
    what the model reads."""

    node: NodeData
    residual: Array
    declared: Array
    inputs: Array
    predicted: Array


def traces(problem: Problem, state: State, weights: Weights) -> dict[str, Trace]:
    """The residual of each node at a state, with what wanders at random followed as far as it is modelled."""
    readings, effects = predict(problem, state), effects_of(problem, state.terms)
    beside = wandered(problem, state, readings, weights)
    made = {}
    for node in problem.nodes:
        own, reading = effects[node.name], readings[node.name]
        predicted = stacked(reading) + beside[node.name].walks
        if BY_NAME["sample_repeat"] in own:
            fresh = weights.noise[node.name].fresh
            predicted = predicted[:, np.maximum.accumulate(np.where(fresh, np.arange(len(fresh)), 0))]
        inputs = input_noise(problem, node, reading, state.starts.get(node.name, Start()))
        declared = np.hypot(sensor_noise(problem, own.values()), inputs)
        made[node.name] = Trace(node, node.y - predicted, declared, inputs, predicted)
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
    """The gap that would be left if nothing but noise were: the scatter from sample to sample, and that of
    the inputs as it is declared."""
    total, count = 0.0, 0
    for name, trace in traced.items():
        spare = np.hypot(weights.noise[name].found, trace.inputs) / trace.declared
        total, count = total + float(np.sum(spare[trace.node.used] ** 2)), count + spare[trace.node.used].size
    return float(np.sqrt(total / count)) if count else float("nan")
