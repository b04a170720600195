"""Scalar calibration: truth is recovered within sigma, and degenerate pose sets are refused."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from generators.poses import Errors
from hubodo.errors import CalibrationError, InputError
from hubodo.sensors.imu.pose_observability import assess_poses, pose_design_matrix
from hubodo.sensors.imu.scalar_calibration import fit_scalar_calibration

PAPER = Errors(
    (2e-4, 2e-4, 2e-4),
    (2e-4, 4e-4, 4e-4),
    {"xz": 2e-4, "yz": -2e-4, "zy": 2e-4, "xy": -2e-4, "yx": 2e-4, "zx": -2e-4},
)
FIBONACCI = np.pi * (3 - np.sqrt(5))


def sphere(count):
    z = 1 - (2 * np.arange(count) + 1) / count
    ring = np.sqrt(1 - z**2)
    angle = FIBONACCI * np.arange(count)
    return np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])


def test_the_case_of_the_paper_is_recovered_exactly_without_linearisation_error():
    result = fit_scalar_calibration(PAPER.measure(sphere(20)), 1.0, np.full((20, 3), 1e-12))
    truth = np.array([2e-4, 2e-4, 2e-4, 2e-4, 4e-4, 4e-4, 4e-4, 4e-4, 4e-4])
    assert np.abs(result.parameters / truth - 1).max() < 1e-9
    # The angles of the paper are antisymmetric, as the symmetric convention assumes, so all six are
    # recovered.
    for name, angle in result.triad.nonorthogonality.items():
        assert angle == pytest.approx(PAPER.d[name], rel=1e-9)


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(10, 40))
def test_any_errors_of_ten_per_cent_are_found_from_any_sufficient_poses_without_their_directions(seed, count):
    rng = np.random.default_rng(seed)
    directions = rng.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    if assess_poses(directions).condition > 100:
        return
    b, e, s = rng.uniform(-0.1, 0.1, (3, 3))
    matrix = np.eye(3) + np.diag(e) + np.array([[0, s[0], s[1]], [s[0], 0, s[2]], [s[1], s[2], 0]]) / 4
    result = fit_scalar_calibration(9.8 * (directions @ matrix.T + b), 9.8, np.full((count, 3), 1e-8))
    assert np.abs(result.triad.bias - 9.8 * b).max() < 1e-6
    assert np.abs(result.triad.matrix - matrix).max() < 1e-6


def test_a_general_optimiser_finds_the_same_minimum():
    rng = np.random.default_rng(5)
    u = PAPER.measure(sphere(30)) + 0.01 * rng.standard_normal((30, 3))
    result = fit_scalar_calibration(u, 1.0, np.full((30, 3), 0.01))

    def residual(p):
        m = np.eye(3) + np.diag(p[3:6])
        for (i, j), half in zip(((0, 1), (0, 2), (1, 2)), p[6:] / 2, strict=False):
            m[i, j] = m[j, i] = half
        inverse = np.linalg.inv(m)
        w = (u - p[:3]) @ inverse.T
        own = 1e-4 * (inverse**2).sum()
        return ((w**2).sum(axis=1) - own - 1) / 2 / (0.01 * np.linalg.norm(w @ inverse, axis=1))

    other = least_squares(residual, np.zeros(9), xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    # Weights are constant within each Gauss-Newton step but not here: a difference of second order in the
    # noise.
    assert np.abs(result.parameters - other).max() < 0.1 * np.sqrt(np.diag(result.covariance)).min()


def test_the_rows_of_matrix_5_are_the_derivative_of_the_length():
    rng = np.random.default_rng(1)
    g = sphere(12)
    p = rng.standard_normal(9)

    def half_square(h):
        b, e, d = h * p[:3], h * p[3:6], h * p[6:]
        m = np.eye(3) + np.diag(e) + np.array([[0, d[0], d[1]], [0, 0, d[2]], [0, 0, 0]])
        return ((g @ m.T + b) ** 2).sum(axis=1) / 2

    numeric = (half_square(1e-6) - half_square(-1e-6)) / 2e-6
    assert np.abs(pose_design_matrix(g) @ p - numeric).max() < 1e-8


def test_sigmas_cover_the_scatter_over_200_seeds_whichever_convention():
    sigma = np.full((14, 3), 1e-3)
    for convention in ("symmetric", "x-first"):
        z = []
        exact = fit_scalar_calibration(PAPER.measure(sphere(14)), 1.0, sigma * 1e-6, convention=convention)
        for seed in range(200):
            rng = np.random.default_rng(seed)
            u = PAPER.measure(sphere(14)) + 1e-3 * rng.standard_normal((14, 3))
            result = fit_scalar_calibration(u, 1.0, sigma, convention=convention)
            if convention == "symmetric":
                truth = np.array([2e-4, 2e-4, 2e-4, 2e-4, 4e-4, 4e-4, 4e-4, 4e-4, 4e-4])
                # Five degrees of freedom: the inflation by chi² is active in half of the runs and is undone
                # here.
                z.append(
                    (result.parameters - truth)
                    / np.sqrt(np.diag(result.covariance) / max(1, result.reduced_chi2))
                )
            else:
                spread = result.sigma / np.sqrt(max(1, result.reduced_chi2))
                own = spread > 0
                off = np.concatenate(
                    [result.triad.bias - exact.triad.bias, (result.triad.matrix - exact.triad.matrix).ravel()]
                )
                z.append(off[own] / spread[own])
        rms = np.sqrt(np.mean(np.square(z), axis=0))
        # An rms of 200 values has a standard deviation of 5 %; the tolerance is four of them.
        assert np.abs(rms - 1).max() < 0.2, (convention, rms)


def test_x_first_leaves_sensor_x_on_its_axis_and_measures_the_same_lengths():
    u = 9.8 * PAPER.measure(sphere(15))
    sigma = np.full((15, 3), 1e-6)
    a = fit_scalar_calibration(u, 9.8, sigma)
    b = fit_scalar_calibration(u, 9.8, sigma, convention="x-first")
    assert np.abs(b.triad.matrix[np.triu_indices(3, 1)]).max() == 0
    lengths = [np.linalg.norm(c.triad.correct(u), axis=1) for c in (a, b)]
    assert np.abs(lengths[0] - lengths[1]).max() < 1e-12


def test_norm_errors_before_and_after_are_in_the_unit_of_the_measurement():
    measured = 9.81 * Errors((0.02, -0.01, 0.03), (0.03, -0.02, 0.01)).measure(sphere(24))
    result = fit_scalar_calibration(measured, 9.81, np.full((24, 3), 1e-6))
    np.testing.assert_allclose(result.residual_before, np.linalg.norm(measured, axis=1) - 9.81, atol=1e-9)
    assert np.abs(result.residual).max() < 1e-6 < 0.1 < np.abs(result.residual_before).max()


def circle(count, axis):
    a = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.roll(np.column_stack([np.zeros(count), np.cos(a), np.sin(a)]), axis, axis=1)


@pytest.mark.parametrize("noise", [1e-10, 1e-6, 1e-3])
@pytest.mark.parametrize(
    "poses, blind, helps",
    [
        (np.tile([[0.0, 0.0, 1.0]], (12, 1)), "scale x", "straight up"),
        (circle(12, 0), "bias x", "x"),
        (circle(12, 1), "bias y", "y"),
        (np.vstack([np.eye(3), -np.eye(3), np.eye(3), -np.eye(3)]), "xz - yz", "midway"),
        (sphere(8), "xz - yz", "up"),
        (np.vstack([circle(8, 0), circle(8, 1)]), "xz - yz", "midway"),
    ],
    ids=[
        "one pose",
        "turned about x alone",
        "turned about y alone",
        "six faces",
        "eight poses",
        "two circles",
    ],
)
def test_degenerate_pose_sets_are_refused_with_parameter_and_helpful_pose(poses, blind, helps, noise):
    rng = np.random.default_rng(3)
    u = PAPER.measure(poses) + noise * rng.standard_normal(poses.shape)
    with pytest.raises(CalibrationError) as caught:
        fit_scalar_calibration(u, 1.0, np.full(u.shape, noise))
    text = str(caught.value)
    assert blind in text and helps in text.partition("that would help: ")[2]


def test_a_set_that_is_degenerate_only_after_correction_is_refused():
    poses = circle(14, 2)
    big = Errors((0.1, -0.1, 0.12), (0.05, -0.05, 0.03), {"xz": 0.02})
    with pytest.raises(CalibrationError):
        fit_scalar_calibration(big.measure(poses), 1.0, np.full((14, 3), 1e-4))


def test_the_suggested_poses_make_a_degenerate_set_sufficient():
    poses = list(circle(12, 2))
    words = assess_poses(np.array(poses), 1e-4).suggestions
    axes = {"x": 0, "y": 1, "z": 2}
    for text in words:
        up = np.zeros(3)
        for sign, axis in itertools.pairwise(text):
            if sign in "+-" and axis in axes:
                up[axes[axis]] = 1 if sign == "+" else -1
        poses.append(up / np.linalg.norm(up))
    assert assess_poses(np.array(poses), 1e-4).is_sufficient


@pytest.mark.parametrize("factor, unit", [(1 / 9.80665, "in g"), (1000 / 9.80665, "in mg")])
def test_a_wrong_unit_is_named_by_its_magnitude(factor, unit):
    with pytest.raises(CalibrationError, match=unit):
        fit_scalar_calibration(9.8 * factor * sphere(12), 9.80665, np.full((12, 3), 1e-3))


def test_an_impossible_reference_or_convention_is_refused():
    u = sphere(12)
    with pytest.raises(InputError, match="positive"):
        fit_scalar_calibration(u, -1.0, np.full((12, 3), 1e-3))
    with pytest.raises(InputError, match="symmetric or x-first"):
        fit_scalar_calibration(u, 1.0, np.full((12, 3), 1e-3), convention="upper")
