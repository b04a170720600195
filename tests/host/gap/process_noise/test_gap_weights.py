"""Weights: random walk of the wheel phase by integrated input noise."""

import pytest

from hubodo.gap.process_noise.weights import declared_weights, declared_wheel_walk, shared_wheel_walk


def test_phase_walks_of_both_wheels_correlate_by_speed_noise_and_anticorrelate_by_yaw_noise(problem):
    left, right = problem.nodes
    radius, half_track = left.forward.wheel_radius, 0.5 * left.forward.track_width
    speed = problem.speed_noise**2 * problem.speed_period / radius**2
    yaw = problem.yaw_rate_noise**2 * problem.yaw_rate_period * half_track**2 / radius**2
    assert declared_wheel_walk(problem, left) == pytest.approx(speed + yaw)
    assert shared_wheel_walk(problem, left, right) == pytest.approx(speed - yaw)


def test_declared_weights_have_the_noise_of_the_model_file(problem):
    weights = declared_weights(problem, {})
    noise = problem.model.noise
    assert weights.noise["left"].sigma[[0, 5], 3].tolist() == pytest.approx([noise.gyro, noise.accel])
