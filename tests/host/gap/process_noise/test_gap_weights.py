"""Weights: the walk of a wheel that integrates the noise of the inputs."""

import pytest

from hubodo.gap.process_noise.weights import declared_weights, declared_wheel_walk, shared_wheel_walk


def test_wheels_share_the_noise_of_the_speed_and_oppose_in_that_of_the_yaw_rate(problem):
    left, right = problem.nodes
    radius, half = left.forward.wheel_radius, 0.5 * left.forward.track_width
    speed = problem.speed_noise**2 * problem.speed_period / radius**2
    yaw = problem.yaw_rate_noise**2 * problem.yaw_rate_period * half**2 / radius**2
    assert declared_wheel_walk(problem, left) == pytest.approx(speed + yaw)
    assert shared_wheel_walk(problem, left, right) == pytest.approx(speed - yaw)


def test_declared_weights_have_the_noise_of_the_model_file(problem):
    weights = declared_weights(problem, {})
    noise = problem.model.noise
    assert weights.noise["left"].sigma[[0, 5], 3].tolist() == pytest.approx([noise.gyro, noise.accel])
