"""GTSAM as an independent solver of the graph's problem: elimination, relinearisation and robust losses."""

import math

import numpy as np

import wanted
from hubodo.fuse.graph.factors.constants import N_CONSTANTS

CONSTANTS_KEY = 1 << 60
"""Key of the vector of constants; poses are numbered from 0."""


def solve_with_gtsam(graph, poses, constants):
    """Return poses, constants and cost by Levenberg-Marquardt.

    Elimination is sequential, because the default recursion overflows the stack on long chains.
    """
    gtsam = wanted.module("gtsam")
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType("SEQUENTIAL_QR")
    parameters.setRelativeErrorTol(1e-12)
    parameters.setAbsoluteErrorTol(1e-9)
    oracle = gtsam_graph(gtsam, graph)
    values = gtsam.LevenbergMarquardtOptimizer(
        oracle, gtsam_values(gtsam, poses, constants), parameters
    ).optimize()
    estimate = _poses(values, range(len(poses)))
    estimate[:, 2] = np.unwrap(estimate[:, 2])
    return estimate, np.asarray(values.atVector(CONSTANTS_KEY)), float(oracle.error(values))


def covariances_of_gtsam(graph, poses, constants):
    """Return the covariances (n, 3, 3) of the poses in world axes and that of the constants, at values."""
    gtsam = wanted.module("gtsam")
    values = gtsam_values(gtsam, poses, constants)
    marginals = gtsam.Marginals(gtsam_graph(gtsam, graph), values)
    turns = [_turn(heading) for heading in poses[:, 2]]
    blocks = [turn @ marginals.marginalCovariance(k) @ turn.T for k, turn in enumerate(turns)]
    return np.array(blocks), marginals.marginalCovariance(CONSTANTS_KEY)


def gtsam_graph(gtsam, graph):
    """Return a NonlinearFactorGraph of all factors."""
    oracle = gtsam.NonlinearFactorGraph()
    for factors in graph.factors:
        for i, state in enumerate(factors.pose_index.tolist()):
            oracle.add(_factor(gtsam, factors.select_factor(i), state))
    return oracle


def gtsam_values(gtsam, poses, constants):
    """Return the Values of poses (n, 3) and of the constants."""
    oracle = gtsam.Values()
    for k, (x, y, heading) in enumerate(poses.tolist()):
        oracle.insert(k, gtsam.Pose2(x, y, heading))
    oracle.insert(CONSTANTS_KEY, constants)
    return oracle


def _poses(values, keys):
    """Return x, y, heading, (n, 3), with headings within half a turn, as in GTSAM."""
    estimate = [values.atPose2(key) for key in keys]
    return np.array([[pose.x(), pose.y(), pose.theta()] for pose in estimate])


def _turn(heading):
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _factor(gtsam, row, state):
    """Return one factor on a pose, on the next pose if there is one, and on the constants.

    GTSAM's increments of a pose are along the pose's own axes, ours along the world's, so the derivatives by
    x and y are rotated.
    """
    probe = row.linearise(np.zeros((2, 3)), np.zeros(N_CONSTANTS))
    keys = [state] if probe.next_pose_jacobian is None else [state, state + 1]

    def evaluate(factor, values, jacobians):
        poses = _poses(values, keys)
        if len(poses) == 2:
            # Headings on both sides of GTSAM's cut at half a turn are made continuous.
            poses[1, 2] += 2.0 * np.pi * np.round((poses[0, 2] - poses[1, 2]) / (2.0 * np.pi))
        item = row.linearise(poses, values.atVector(CONSTANTS_KEY))
        if jacobians is not None:
            blocks = (
                [item.pose_jacobian[0]]
                if item.next_pose_jacobian is None
                else [item.pose_jacobian[0], item.next_pose_jacobian[0]]
            )
            for index, (block, pose) in enumerate(zip(blocks, poses, strict=True)):
                jacobians[index] = np.asfortranarray(block @ _turn(pose[2]))
            jacobians[len(keys)] = np.asfortranarray(item.constants_jacobian[0])
        return np.asarray(item.residual[0])

    noise = _noise(gtsam, row.loss, probe.residual.shape[1])
    return gtsam.CustomFactor(noise, [*keys, CONSTANTS_KEY], evaluate)


def _noise(gtsam, loss, rows):
    """Return unit noise under a loss; Huber's is GTSAM's own."""
    unit = gtsam.noiseModel.Unit.Create(rows)
    if loss.kind == "quadratic":
        return unit
    estimators = gtsam.noiseModel.mEstimator
    if loss.kind == "huber":
        return gtsam.noiseModel.Robust.Create(estimators.Huber.Create(float(np.sqrt(loss.limit))), unit)
    bounded = estimators.Custom.Create(
        lambda norm: float(loss.weight(np.array(norm * norm))),
        lambda norm: float(loss.cost(np.array(norm * norm))),
        reweight=estimators.Base.ReweightScheme.Block,
        name="bounded",
    )
    return gtsam.noiseModel.Robust.Create(bounded, unit)
