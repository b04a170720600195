"""Error of a speed measured by a gyro on a wheel."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np

from hubodo.effects import BY_NAME
from hubodo.gap.problem.problem import NodeData
from hubodo.gap.state.measured_speed import (
    SpeedError,
    average_speed_errors,
    compute_speed_error,
    correct_measured_speed,
)
from hubodo.gap.state.state import State
from hubodo.gap.state.terms import ModelTerm


def test_a_gyro_without_errors_needs_no_speed_correction(problem):
    error = compute_speed_error(problem.nodes[0], {}, False)
    np.testing.assert_allclose(error.correction, 0.0, atol=1e-9)


def test_a_bias_corrects_the_speed_by_bias_times_radius_and_by_half_of_it_with_two_wheels(problem):
    nodes, bias = problem.nodes, BY_NAME["gyro_bias"](z=0.1)
    error = compute_speed_error(nodes[0], {type(bias): bias}, False).correction
    np.testing.assert_allclose(np.abs(error), 0.1 * nodes[0].forward.wheel_radius, rtol=1e-6)
    average = average_speed_errors(nodes, np.full((2, 1), 0.5), {nodes[0].name: error})
    np.testing.assert_allclose(average, 0.5 * error)


def test_a_late_clock_corrects_the_speed_by_delay_times_acceleration(problem):
    node, delay = problem.nodes[0], 0.01
    offset = BY_NAME["time_offset"](delay=delay)
    error = compute_speed_error(node, {type(offset): offset}, is_only_source=False)
    body = node.forward.inputs.at(node.t)
    y = 0.5 * (1.0 if node.mount.side == "left" else -1.0) * node.forward.track_width
    expected = delay * (body.acceleration - y * body.yaw_acceleration)
    scale = np.abs(expected).max()
    assert scale > 0.0
    assert np.abs(error.correction - expected).max() < 0.05 * scale


def test_the_speed_of_two_gyros_is_corrected_for_a_clock_that_is_late_by_a_fifth_of_a_second():
    t, delay = np.arange(0.0, 40.0, 0.01), 0.2
    speed = lambda at: 5.0 + np.sin(1.5 * at) + 0.5 * np.sin(3.1 * at + 1.0)  # noqa: E731
    measured = 0.5 * (speed(t) + speed(t - delay))
    sources = [cast(NodeData, SimpleNamespace(name=name, t=t)) for name in ("left", "right")]
    at_reading = np.interp(t - delay, t, measured)
    errors = {
        "left": SpeedError(measured - at_reading, np.zeros_like(t), np.zeros_like(t), t - delay),
        "right": SpeedError(np.zeros_like(t), np.zeros_like(t), np.zeros_like(t), t),
    }
    corrected = measured + correct_measured_speed(sources, np.full((2, 1), 0.5), errors)
    inside = slice(200, -200)
    first_order = measured + 0.5 * errors["left"].correction
    assert np.abs(first_order - speed(t))[inside].max() > 0.03
    assert np.abs(corrected - speed(t))[inside].max() < 0.005


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
