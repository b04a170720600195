"""What wanders at random beside a model: angles of wheels, clocks, drift of gyros, noise of the inputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np

from hubodo.arrays import Array
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.gap.process_noise.parts import window_of
from hubodo.gap.process_noise.weights import shared_walk
from hubodo.gap.process_noise.wheel_phase import WINDOW
from hubodo.gap.process_noise.window_sums import Walk
from hubodo.gap.state.state import State
from hubodo.vehicle import side_sign

# s in which a clock that is corrected again and again wanders by as much as it is off.
_CLOCK_WANDERS = 10.0

# What two wheels' steps have in common at most: no two roll quite alike. With less of their own, where one is
# lost, its path would be judged more strictly than the arithmetic holds.
_ALIKE = 0.9

What = Literal["speed", "speed slope", "yaw rate", "yaw rate slope", "wheel", "clock", "gx", "gy", "gz"]


@dataclass(frozen=True)
class Wandering:
    """Something that wanders. node: where; "" where all nodes feel it alike."""

    walk: Walk
    what: What
    node: str = ""

    def path(self, state: State) -> Array | float:
        """(N,) of its node, where it was thought to be."""
        followed = {"wheel": state.paths, "clock": state.late}.get(self.what, {})
        return followed.get(self.node, 0.0)


def process_noise(state: State, wheel_walks: Mapping[str, float]) -> list[Wandering]:
    """What wanders beside the model at a state. wheel_walks: rad²/s, of the angle of each wheel."""
    made = list(_input_noise(state.problem))
    for node in state.problem.nodes:
        if node.on_wheel:
            made.append(Wandering(Walk(wheel_walks[node.name]), "wheel", node.name))
        if state.problem.model.inputs.clock_sigma > 0.0:
            made.append(Wandering(clock_walk(state.problem), "clock", node.name))
        drift = sum(effect.random_walk_variance_rate() for effect in state.effects[node.name].values())
        if drift > 0.0:
            walk = Walk(drift, drift * WINDOW)
            made += [Wandering(walk, row, node.name) for row in ("gx", "gy", "gz")]
    return made


def shared_steps(problem: Problem, wanderings: Sequence[Wandering]) -> Array:
    """(C, C) covariance per second of the steps of different wheels, which integrate the same inputs."""
    made = np.zeros((len(wanderings), len(wanderings)))
    nodes = {node.name: node for node in problem.nodes}
    wheels = [(k, nodes[it.node]) for k, it in enumerate(wanderings) if it.what == "wheel"]
    for (k, one), (j, other) in permutations(wheels, 2):
        made[k, j] = _ALIKE * shared_walk(problem, one, other)
    return made


def felt(wanderings: Sequence[Wandering], node: NodeData) -> list[int]:
    """(C,) places of what one node feels."""
    return [k for k, it in enumerate(wanderings) if it.node in ("", node.name)]


def answers(state: State, node: NodeData, wanderings: Sequence[Wandering], begins: Array) -> Array:
    """(C, 6, N): change of the channels of a node per unit of each that it feels.

    begins: s, of the windows in which its samples are.
    """
    places = felt(wanderings, node)
    made = np.zeros((len(places), *node.y.shape))
    of_inputs = _input_answers(state, node, begins) if any(not it.node for it in wanderings) else {}
    for into, place in zip(made, places, strict=True):
        what = wanderings[place].what
        if what == "wheel":
            into[:] = state.phase_columns[node.name]
        elif what == "clock":
            into[:] = state.late_columns[node.name]
        elif what in of_inputs:
            into[:] = of_inputs[what]
        else:
            into[("gx", "gy", "gz").index(what)] = 1.0
    return made


def clock_walk(problem: Problem) -> Walk:
    """How late the stamps of a node are: off by clock_sigma at first, and slowly wandering by as much."""
    variance = problem.model.inputs.clock_sigma**2
    return Walk(variance / _CLOCK_WANDERS, variance)


def window_variances(problem: Problem) -> tuple[float, float]:
    """Of what the noise of the inputs leaves in a window's mean: (m/s)² and (rad/s)²."""
    speed = problem.speed_noise**2 * min(1.0, problem.speed_period / WINDOW)
    yaw_rate = problem.yaw_rate_noise**2 * min(1.0, problem.yaw_rate_period / WINDOW)
    return speed, yaw_rate


def _input_noise(problem: Problem) -> Iterator[Wandering]:
    """The noise of the samples of the inputs, as it is left in the mean and in the slope of a window.

    White noise of n samples leaves 1/n of its variance in their mean and 12/(n T²) in their slope; the same
    for all nodes.
    """
    whats: tuple[tuple[What, What], ...] = (("speed", "speed slope"), ("yaw rate", "yaw rate slope"))
    for variance, (level, slope) in zip(window_variances(problem), whats, strict=True):
        if variance > 0.0:
            yield Wandering(Walk(0.0, variance, white=True), level)
            yield Wandering(Walk(0.0, 12.0 * variance / WINDOW**2, white=True), slope)


def _input_answers(state: State, node: NodeData, begins: Array) -> dict[What, Array]:
    """(6, N) each: what a node answers to level and slope of the inputs' noise within a window.

    That turns a wheel within the window, too; how far from one window to the next is a walk.
    """
    own = state.input_answers(node)
    at = node.t - (begins[window_of(begins, node.t)] + 0.5 * WINDOW)
    bent = 0.5 * (at**2 - WINDOW**2 / 12.0)
    phase = state.phase_columns.get(node.name, np.zeros(1)) / node.forward.wheel_radius
    y = side_sign(node.mount.side or "left") * node.forward.track_width / 2.0
    return {
        "speed": own.speed + at * phase,
        "speed slope": at * own.speed + own.acceleration + bent * phase,
        "yaw rate": own.yaw_rate - y * at * phase,
        "yaw rate slope": at * own.yaw_rate - y * bent * phase,
    }
