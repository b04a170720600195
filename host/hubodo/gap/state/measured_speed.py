"""Errors of a speed input measured by gyros on wheels, given the effects that the model assigns to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.effects import Effect
from hubodo.effects.sensor_chain import SensorChain
from hubodo.gap.problem.problem import NodeData, Problem
from hubodo.model.forward import NodeInitialState
from hubodo.vehicle import facing_sign


@dataclass(frozen=True)
class SpeedError:
    """Error of the speed measured by one gyro.

    correction: (N,) m/s to be added to the measured speed, without that for late readings
    correction_per_rate: (N,) m, change of the correction per rad/s of gyro error
    angle: (N,) rad, wheel angle for which the error of the gyro was computed
    true_times: (N,) s, when the gyro was read, according to its clock effects
    """

    correction: Array
    correction_per_rate: Array
    angle: Array
    true_times: Array


def compute_speed_error(
    node: NodeData,
    effects: Mapping[type[Effect], Effect],
    is_only_source: bool,
    phase_offset: Array | float = 0.0,
) -> SpeedError:
    """Return the error of the speed that a z gyro and the nominal radius give.

    is_only_source: True if no gyro on another wheel contributes to the speed
    phase_offset: (N,) rad, wheel angle minus that of the measured motion: the direction of gravity decides
        what an acceleration-sensitive gyro reads
    """
    mean_effects = [effect for effect in effects.values() if effect.visible_in == "mean"]
    reading = node.forward.mean_reading(mean_effects, NodeInitialState(), phase_offset)
    rolling, body = reading.rolling, reading.body
    assert rolling is not None
    nominal, side = node.forward.wheel_radius, 1.0 if node.mount.side == "left" else -1.0
    facing = facing_sign(node.mount.facing or "left")
    y = 0.5 * side * node.forward.track_width
    gyro_error = facing * reading.gyro[2] - rolling.spin
    contact = body.speed - body.yaw_rate * y
    turning = np.abs(rolling.spin) > 1e-2
    radius = np.where(turning, contact / np.where(turning, rolling.spin, 1.0), nominal)
    error = (radius / nominal - 1.0) * contact - radius * gyro_error
    correction = error + body.yaw_rate * y if is_only_source else error
    return SpeedError(correction, -facing * radius, rolling.angle, body.t)


def build_measuring_chain(
    node: NodeData, effects: Mapping[type[Effect], Effect], phase_offset: Array | float = 0.0
) -> SensorChain:
    """Return the input of a speed-measuring sensor for the motion as it was measured.

    phase_offset: as in `compute_speed_error`
    """
    mean_effects = [effect for effect in effects.values() if effect.visible_in == "mean"]
    return node.forward.true_signals(mean_effects, NodeInitialState(), phase_offset)[0]


def correct_measured_speed(problem: Problem, errors: Mapping[str, SpeedError]) -> Array:
    """Return the correction of a speed that gyros measured, (N,) m/s, at the stamps of the first of them.

    errors: by node

    Readings of a gyro whose clock is wrong are shifted to the times at which they were taken. The mean speed
    of two gyros alone does not show what was lost in it: at 2.5 Hz, readings that are 0.2 s late cancel the
    punctual ones.
    """
    sources, weights = problem.speed_source_nodes, problem.speed_weights
    changes = {name: error.correction for name, error in errors.items()}
    times, t = {name: error.true_times for name, error in errors.items()}, sources[0].t
    correction = problem.speed_filter.apply(average_speed_errors(sources, weights, changes, times))
    for node, weight in zip(sources, weights, strict=True):
        if not np.array_equal(times[node.name], node.t):
            speed = problem.wheel_speeds[node.name]
            shift = np.interp(t, times[node.name], speed) - np.interp(t, node.t, speed)
            correction = correction + weight * shift
    return correction


def average_speed_errors(
    sources: Sequence[NodeData],
    weights: Array,
    errors: Mapping[str, Array],
    times: Mapping[str, Array],
) -> Array:
    """Return the weighted mean error of the gyros, (N,) m/s, at the time stamps of the first source.

    weights: (S, N), as in `Problem.speed_weights`
    errors: by node; a missing node counts as 0
    times: by node, s, when the readings with these errors were taken
    """
    t = sources[0].t
    total = np.zeros(len(t))
    for node, weight in zip(sources, weights, strict=True):
        if node.name in errors:
            error, at = errors[node.name], times[node.name]
            total += weight * (error if at is t else np.interp(t, at, error))
    return total
