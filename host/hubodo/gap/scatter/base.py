"""What a look at one kind of scatter returns, and the rest of a node that it looks at."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.gap.noise import ChannelNoise, input_answers, input_noise, sensor_noise
from hubodo.gap.problem import NodeData, Problem
from hubodo.gap.state import State, effects_of, predict, stacked
from hubodo.gap.terms import ALL, Term
from hubodo.gap.wander import Weights, wandered, window_variances
from hubodo.model.forward import Start


@dataclass(frozen=True)
class Proposal:
    """An effect that would explain the scatter. gain: of the log-likelihood. evidence: ln Bayes factor.

    sigmas: 1 sigma of its parameters. where: what shows it, in words.
    """

    term: Term
    gain: float
    evidence: float
    sigmas: Mapping[str, float]
    where: str


@dataclass(frozen=True)
class Rest:
    """What a node shows beyond the model. residual: (6, N), with what walks at random followed. inputs:
    (6, N), what of it the noise of the inputs may have made; input_variance: (6,) of that in a window's mean.
    declared: (6, N), 1 sigma that the model file asks for. effects: what the model gives the node."""

    node: NodeData
    residual: Array
    inputs: Array
    input_variance: Array
    noise: ChannelNoise
    declared: Array
    effects: Mapping[type[Effect], Effect]


def rests(problem: Problem, state: State, weighed: Weights) -> list[Rest]:
    """What each node shows beyond the model."""
    readings, effects = predict(problem, state), effects_of(problem, state.terms)
    beside = wandered(problem, state, readings, weighed)
    made = []
    speed, yaw_rate = window_variances(problem)
    for node in problem.nodes:
        reading, own = readings[node.name], effects[node.name]
        start = state.starts.get(node.name, Start())
        inputs, answers = input_noise(problem, node, reading, start), input_answers(node, reading, start)
        in_means = speed * np.mean(answers.speed**2, axis=1) + yaw_rate * np.mean(answers.yaw_rate**2, axis=1)
        declared = np.hypot(sensor_noise(problem), inputs)
        residual = node.y - stacked(reading) - beside[node.name].walks
        noise = weighed.noise[node.name]
        made.append(Rest(node, residual, beside[node.name].inputs, in_means, noise, declared, own))
    return made


Look = Callable[[Sequence[Rest]], list[Proposal]]


def single_cost(samples: float) -> float:
    """Occam's factor of one parameter that so many samples fix: ½ ln(samples), as in BIC."""
    return 0.5 * log(max(samples, 3.0))


def shared(rests: Sequence[Rest]) -> list[tuple[str, list[Rest]]]:
    """The scopes: each node, and all of them where there are several."""
    single = [(rest.node.name, [rest]) for rest in rests]
    return [*single, (ALL, list(rests))] if len(rests) > 1 else single
