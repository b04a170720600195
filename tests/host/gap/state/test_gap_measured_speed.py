"""Error of a speed measured by a gyro on a wheel."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.problem.problem import Problem
from hubodo.gap.state.measured_speed import (
    SpeedError,
    average_speed_errors,
    compute_speed_error,
    correct_measured_speed,
)
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm
from hubodo.smoothing_spline import LowPass


def test_a_gyro_without_errors_needs_no_speed_correction(problem):
    error = compute_speed_error(problem.nodes[0], {}, False)
    np.testing.assert_allclose(error.correction, 0.0, atol=1e-9)


def test_a_bias_corrects_the_speed_by_bias_times_radius_and_by_half_of_it_with_two_wheels(problem):
    nodes, bias = problem.nodes, BY_NAME["gyro_bias"](z=0.1)
    error = compute_speed_error(nodes[0], {type(bias): bias}, False).correction
    np.testing.assert_allclose(np.abs(error), 0.1 * nodes[0].forward.wheel_radius, rtol=1e-6)
    name, times = nodes[0].name, {nodes[0].name: nodes[0].t}
    average = average_speed_errors(nodes, np.full((2, 1), 0.5), {name: error}, times)
    np.testing.assert_allclose(average, 0.5 * error)


@pytest.mark.parametrize("delay", [0.01, 1e-8])
def test_a_late_clock_corrects_the_speed_by_half_of_delay_times_acceleration(problem, delay):
    """The smaller delay is the step of a derivative: noise of the gyro must not dominate it."""
    seed = 4
    print(f"seed {seed}")
    noise = 0.05 * np.random.default_rng(seed).normal(size=(3, *problem.nodes[0].y.shape))
    nodes = tuple(replace(node, y=node.y + n) for node, n in zip(problem.nodes, noise, strict=False))
    speed = replace(problem.inputs.speed, cutoff=1.0)
    inputs = replace(problem.inputs, speed=speed)
    state = State(replace(problem, nodes=nodes, inputs=inputs, speed_sources=("left", "right")))
    node, offset = nodes[0], BY_NAME["time_offset"](delay=delay)
    late = state.with_term(ModelTerm(offset, node.name))
    correction = late.speed_correction.speed - state.speed_correction.speed
    body = node.forward.inputs.at(node.t)
    y = 0.5 * (1.0 if node.mount.side == "left" else -1.0) * node.forward.track_width
    expected = 0.5 * delay * (body.acceleration - y * body.yaw_acceleration)
    inside = slice(50, -50)
    assert np.std((correction - expected)[inside]) < 0.1 * np.std(expected)


def test_the_speed_of_two_gyros_is_corrected_for_a_clock_that_is_late_by_half_a_period():
    """The mean of both has nothing of a motion of 2.5 Hz if one is 0.2 s late."""
    t, delay = np.arange(0.0, 40.0, 0.01), 0.2
    speed = lambda at: 5.0 + np.sin(1.5 * at) + 0.1 * np.sin(2.0 * np.pi * 2.5 * at)  # noqa: E731
    measured = {"left": speed(t - delay), "right": speed(t)}
    sources = tuple(SimpleNamespace(name=name, t=t) for name in measured)
    problem = SimpleNamespace(
        speed_source_nodes=sources,
        speed_weights=np.full((2, 1), 0.5),
        speed_filter=LowPass(t, np.inf),
        wheel_speeds=measured,
    )
    zero = np.zeros_like(t)
    errors = {"left": SpeedError(zero, zero, zero, t - delay), "right": SpeedError(zero, zero, zero, t)}
    corrected = 0.5 * (measured["left"] + measured["right"]) + correct_measured_speed(
        cast(Problem, problem), errors
    )
    assert np.abs(corrected - speed(t))[30:-30].max() < 1e-3


def test_an_error_faster_than_the_band_of_the_speed_is_not_in_it_and_needs_no_correction(problem):
    """The speed was smoothed to the band of motion; the rate of an eccentric wheel changes once per turn."""
    eccentricity = ModelTerm(BY_NAME["wheel_eccentricity"](amplitude=0.002), "left")

    def rms(cutoff):
        speed = replace(problem.inputs.speed, cutoff=cutoff)
        inputs = replace(problem.inputs, speed=speed)
        state = State(replace(problem, inputs=inputs, speed_sources=("left", "right")), (eccentricity,))
        return np.sqrt(np.mean(state.speed_correction.speed**2))

    print(rms(np.inf), rms(0.05))
    assert rms(0.05) < 0.05 * rms(np.inf)
