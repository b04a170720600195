"""The package's factors handed to GTSAM, one by one: the same residuals, derivatives and losses."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import ConfigError
from hubodo.fuse.graph.factors.constants import COUNT
from hubodo.fuse.graph.factors.linear import QUADRATIC, Linear, Loss
from hubodo.fuse.graph.solver import Graph

CONSTANTS_KEY = 1 << 60
"""Key of the vector of constants; poses are numbered from 0."""

LinearAt = Callable[[Array, Array], Linear]


def load_gtsam() -> Any:
    """The module. Raises ConfigError when it is not installed."""
    try:
        return importlib.import_module("gtsam")
    except ImportError:
        raise ConfigError(
            "the live graph needs GTSAM, which is not installed; pip install 'hubodo[graph]'"
        ) from None


def gtsam_graph(gtsam: Any, graph: Graph, first: int = 0) -> Any:
    """A NonlinearFactorGraph of all factors; pose k has the key first + k."""
    made = gtsam.NonlinearFactorGraph()

    def add(linear: LinearAt, state: int, poses: int, loss: Loss, rows: int) -> None:
        keys = [first + state + step for step in range(poses)]
        made.add(as_gtsam(gtsam, linear, keys, loss, rows))

    for k in range(len(graph.between.whiten)):
        add(graph.between.row(k).linear, k, 2, graph.losses.between, 3)
    if graph.positions is not None:
        for i, state in enumerate(graph.positions.state):
            add(graph.positions.row(i).linear, int(state), 1, graph.losses.position, 2)
    if graph.headings is not None:
        for i, state in enumerate(graph.headings.state):
            add(graph.headings.row(i).linear, int(state), 1, graph.losses.heading, 1)
    alone = replace(graph.start, state=0)
    add(lambda poses, constants: alone.linear(poses), graph.start.state, 1, QUADRATIC, 3)
    made.add(
        as_gtsam(gtsam, lambda poses, constants: graph.constants.linear(constants), [], QUADRATIC, COUNT)
    )
    return made


def gtsam_values(gtsam: Any, poses: Array, constants: Array, first: int = 0) -> Any:
    """Values of poses (n, 3), keys from `first`, and of the constants."""
    made = gtsam.Values()
    for k, (x, y, heading) in enumerate(poses.tolist()):
        made.insert(first + k, gtsam.Pose2(x, y, heading))
    made.insert(CONSTANTS_KEY, constants)
    return made


def solve_with_gtsam(graph: Graph, poses: Array, constants: Array) -> tuple[Array, Array, float]:
    """Poses, constants and cost as GTSAM's Levenberg-Marquardt finds them: the same optimum as
    `solver.solve`.

    Its factors call back into Python, so it is slow; it stands here to check the other, and for graphs that
    are no chain. Sequential elimination: the default recursion of Gauss-Newton overflows the stack on long
    chains.
    """
    gtsam = load_gtsam()
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType("SEQUENTIAL_QR")
    parameters.setRelativeErrorTol(1e-12)
    parameters.setAbsoluteErrorTol(1e-9)
    made = gtsam_graph(gtsam, graph)
    optimizer = gtsam.LevenbergMarquardtOptimizer(made, gtsam_values(gtsam, poses, constants), parameters)
    values = optimizer.optimize()
    found = pose_array(gtsam, values, list(range(len(poses))))
    found[:, 2] = np.unwrap(found[:, 2])
    return found, np.asarray(values.atVector(CONSTANTS_KEY)), float(made.error(values))


def pose_array(gtsam: Any, values: Any, keys: list[int]) -> Array:
    """(n, 3) x, y, heading of the poses with these keys; headings as GTSAM keeps them, within half a turn."""
    made = np.empty((len(keys), 3))
    for row, key in enumerate(keys):
        pose = values.atPose2(key)
        made[row] = pose.x(), pose.y(), pose.theta()
    return made


def as_gtsam(gtsam: Any, linear: LinearAt, keys: list[int], loss: Loss, rows: int) -> Any:
    """One factor on no, one or two successive poses (keys) and the constants.

    linear: about poses (len(keys), 3) and constants, one row of Linear. GTSAM's increments of a pose are
    along the pose's own axes, ours along the world's, so the derivatives by x and y are turned.
    """

    def evaluate(factor: Any, values: Any, jacobians: list[Array] | None) -> Array:
        poses = pose_array(gtsam, values, keys)
        if len(poses) == 2:
            # GTSAM keeps headings within half a turn; two on both sides of that cut are brought together.
            poses[1, 2] += 2.0 * np.pi * np.round((poses[0, 2] - poses[1, 2]) / (2.0 * np.pi))
        item = linear(poses, values.atVector(CONSTANTS_KEY))
        if jacobians is not None:
            blocks = [item.by_state[0]] if item.by_next is None else [item.by_state[0], item.by_next[0]]
            for index, pose in enumerate(poses):
                c, s = math.cos(pose[2]), math.sin(pose[2])
                turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
                jacobians[index] = np.asfortranarray(blocks[index] @ turn)
            jacobians[len(keys)] = np.asfortranarray(item.by_constants[0])
        return np.asarray(item.residual[0])

    return gtsam.CustomFactor(noise_model(gtsam, loss, rows), [*keys, CONSTANTS_KEY], evaluate)


def noise_model(gtsam: Any, loss: Loss, rows: int) -> Any:
    """Unit noise under a loss."""
    unit = gtsam.noiseModel.Unit.Create(rows)
    if loss.kind == "quadratic":
        return unit
    estimators = gtsam.noiseModel.mEstimator
    if loss.kind == "huber":
        return gtsam.noiseModel.Robust.Create(estimators.Huber.Create(float(np.sqrt(loss.limit))), unit)

    def weight(norm: float) -> float:
        return float(loss.weight(np.array(norm * norm)))

    def cost(norm: float) -> float:
        return float(loss.costs(np.array(norm * norm)))

    return gtsam.noiseModel.Robust.Create(
        estimators.Custom.Create(weight, cost, reweight=estimators.Base.ReweightScheme.Block, name="bounded"),
        unit,
    )
