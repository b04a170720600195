"""Factors of the graph: Jacobians, splitting, losses, and the covariance of odometry segments."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from generators import gnss_drives
from graph_drives import central_differences, small_drive_graph, wiggly_path
from hubodo.fuse.graph.factors.between import BetweenFactors
from hubodo.fuse.graph.factors.constants import N_CONSTANTS
from hubodo.fuse.graph.factors.heading import HeadingFactors
from hubodo.fuse.graph.factors.loss import Loss
from hubodo.fuse.graph.factors.position import PositionFactors
from hubodo.fuse.graph.factors.prior import ConstantsPriorFactors, MarginalPriorFactors, PosePriorFactors
from hubodo.fuse.graph.odometry_steps import StepNoise, check_odometry, segment_odometry
from hubodo.fuse.graph.window import marginalise_first_poses
from hubodo.fuse.track import Track

POSES = 9


def random_between_factors(rng):
    path = wiggly_path(rng, 60)
    edges = np.sort(rng.choice(np.arange(1, 59), POSES - 2, replace=False))
    noise = StepNoise(*rng.uniform(0.002, 0.05, 4))
    return BetweenFactors.from_steps(segment_odometry(path, path.t[[0, *edges, 59]], noise).steps)


def random_poses(rng, count=4):
    """Return the indices of a few poses."""
    return np.sort(rng.choice(POSES, count, replace=False))


def random_sigmas(rng, *shape):
    return np.exp(rng.uniform(-2.0, 2.0, shape))


FACTORS = {
    BetweenFactors: random_between_factors,
    PositionFactors: lambda rng: PositionFactors(
        random_poses(rng),
        rng.normal(0, 5, (4, 2)),
        random_sigmas(rng, 4),
        rng.normal(0, 2, (4, 2)),
        (0.4, -0.7),
    ),
    HeadingFactors: lambda rng: HeadingFactors(
        random_poses(rng), rng.uniform(-9, 9, 4), random_sigmas(rng, 4)
    ),
    PosePriorFactors: lambda rng: PosePriorFactors(
        random_poses(rng, 2), rng.normal(0, 3, (2, 3)), random_sigmas(rng, 2, 3)
    ),
    ConstantsPriorFactors: lambda rng: ConstantsPriorFactors(
        random_poses(rng, 1), rng.normal(0, 1, (1, N_CONSTANTS)), random_sigmas(rng, 1, N_CONSTANTS)
    ),
    MarginalPriorFactors: lambda rng: MarginalPriorFactors(
        random_poses(rng, 1),
        rng.normal(0, 3, (1, 3 + N_CONSTANTS, 3 + N_CONSTANTS)),
        rng.normal(0, 1, (1, 3 + N_CONSTANTS)),
        rng.normal(0, 1, (1, 3 + N_CONSTANTS)),
    ),
}
"""Random factors of each kind, with sigmas that differ from row to row."""


def test_every_kind_of_factor_of_a_drive_and_a_window_has_an_example_here():
    drive = small_drive_graph(np.random.default_rng(46))
    marginalised = marginalise_first_poses(drive.graph, drive.initial_poses, np.zeros(N_CONSTANTS), 3)
    assert {type(group) for group in (*drive.graph.factors, *marginalised.factors)} == set(FACTORS)


@pytest.mark.parametrize("kind", FACTORS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_jacobian_is_the_derivative_of_its_residual(kind, seed):
    rng = np.random.default_rng([seed, 47])
    factors = FACTORS[kind](rng)
    poses = rng.normal(0, 1, (POSES, 3)) * [5.0, 5.0, 2.0]
    constants = rng.normal(0, 1, N_CONSTANTS) * [0.02, 0.02, 0.01, 0.01, 0.3, 0.1, 0.2, 0.2, 0.1, 0.1]
    item = factors.linearise(poses, constants)
    width = item.residual.shape[1]

    def residuals(z):
        return factors.linearise(z[: 3 * POSES].reshape(POSES, 3), z[3 * POSES :]).residual.ravel()

    expected = central_differences(residuals, np.append(poses.ravel(), constants))
    result = np.zeros_like(expected)
    for i, k in enumerate(item.pose_index):
        part = slice(i * width, (i + 1) * width)
        result[part, 3 * k : 3 * k + 3] = item.pose_jacobian[i]
        if item.next_pose_jacobian is not None:
            result[part, 3 * k + 3 : 3 * k + 6] = item.next_pose_jacobian[i]
        result[part, 3 * POSES :] = item.constants_jacobian[i]
    assert np.max(np.abs(result - expected)) < 1e-6 * (1.0 + np.max(np.abs(expected)))


@pytest.mark.parametrize("kind", [PositionFactors, HeadingFactors, PosePriorFactors])
def test_residuals_are_whitened_by_their_own_sigma(kind):
    """Whitening divides each residual by its sigma."""
    rng = np.random.default_rng(48)
    factors = FACTORS[kind](rng)
    poses, constants = rng.normal(0, 1, (POSES, 3)), rng.normal(0, 0.01, N_CONSTANTS)
    unit_sigma = type(factors)(**{**vars(factors), "sigma": np.ones_like(factors.sigma)})
    sigma = factors.sigma[:, None] if factors.sigma.ndim == 1 else factors.sigma
    expected = unit_sigma.linearise(poses, constants).residual / sigma
    assert np.allclose(factors.linearise(poses, constants).residual, expected)


@pytest.mark.parametrize("kind", FACTORS)
def test_factors_split_and_appended_again_are_unchanged(kind):
    rng = np.random.default_rng(49)
    factors = FACTORS[kind](rng)
    poses, constants = rng.normal(0, 1, (POSES, 3)), rng.normal(0, 0.01, N_CONSTANTS)
    full = factors.linearise(poses, constants)
    for cut in range(POSES + 1):
        reassembled = factors.select_poses(0, cut).append(factors.select_poses(cut, POSES), cut)
        item = reassembled.linearise(poses, constants)
        assert item.pose_index.tolist() == full.pose_index.tolist()
        assert np.array_equal(item.residual, full.residual)
    for i, k in enumerate(full.pose_index):
        single = factors.select_factor(i).linearise(poses[k : k + 2], constants)
        assert single.pose_index.tolist() == [0]
        assert np.allclose(single.residual[0], full.residual[i], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("loss", [Loss("quadratic"), Loss("huber", 4.0), Loss("bounded", 12.0)])
def test_the_cost_of_a_loss_is_the_integral_of_its_weight(loss):
    for s in (0.5, 3.9, 4.1, 11.9, 12.1, 30.0, 47.9, 48.1, 400.0):
        area, _ = quad(
            lambda u: 0.5 * float(loss.weight(np.array(u))), 0.0, s, points=[4.0, 12.0, 48.0], limit=200
        )
        assert float(loss.cost(np.array(s))) == pytest.approx(area, rel=1e-6)


def test_an_outlier_fix_has_no_influence():
    loss = PositionFactors.loss
    assert loss.weight(np.array([9.0, 20.0**2])).tolist() == [1.0, 0.0]
    # For an initial guess an outlier keeps some weight; a loss that never rejects is unchanged.
    assert loss.for_initial_guess().weight(np.array(400.0)) == pytest.approx(0.1)
    assert BetweenFactors.loss.for_initial_guess() == BetweenFactors.loss


def test_compounded_steps_reproduce_the_odometry():
    rng = np.random.default_rng(8)
    path = wiggly_path(rng)
    state_t = np.concatenate([[path.t[0]], np.sort(rng.uniform(0.1, 19.0, 30)), [path.t[-1]]])
    segments = segment_odometry(path, state_t, StepNoise())
    item = BetweenFactors.from_steps(segments.steps).linearise(segments.odometry_pose, np.zeros(N_CONSTANTS))
    assert np.max(np.abs(item.residual)) < 1e-9
    assert np.allclose(segments.odometry_pose[:, 0], np.interp(state_t, path.t, path.x))


def test_the_constants_correct_the_errors_of_an_odometer():
    """The reference is the generator's odometer, which has its own integration."""
    errors = gnss_drives.Errors(scale=0.01, turn=0.02, rate=2e-3, curve=5e-3)
    rng = np.random.default_rng(9)
    drive = gnss_drives.drive(rng, gnss_drives.loop(rng, length=60.0), errors)
    path = Track(drive.odo_t, drive.odo_x, drive.odo_y, drive.odo_heading)
    segments = segment_odometry(path, np.array([path.t[0], path.t[-1]]), StepNoise())
    corrections = np.array([1 / 1.01 - 1, 1 / 1.02 - 1, -2e-3 / 1.02, -5e-3 / 1.02 / 1.01, 0.0, 0.0])
    displacement = complex(segments.steps.correct_displacements(corrections).sum()) * np.exp(
        1j * drive.heading[0]
    )
    x, y, heading = drive.truth(path.t[-1])
    assert abs(displacement - (x + 1j * y)) < 2e-3
    assert float(segments.steps.correct_turns(corrections)[0]) == pytest.approx(
        heading - drive.heading[0], abs=1e-3
    )


def test_the_covariance_of_a_segment_equals_a_monte_carlo_simulation():
    rng = np.random.default_rng(10)
    path = wiggly_path(rng, 60)
    noise = StepNoise(along=0.02, sideways=0.01, heading=0.02, heading_per_distance=0.0)
    ends = np.array([path.t[0], path.t[-1]])
    expected = segment_odometry(path, ends, noise).steps.covariance[0]
    step = np.diff(path.x + 1j * path.y) * np.exp(-0.5j * (path.heading[1:] + path.heading[:-1]))
    turn = np.diff(path.heading)
    samples = []
    for _ in range(4000):
        root = np.sqrt(np.abs(step))
        noisy = step + root * (0.02 * rng.standard_normal(59) + 0.01j * rng.standard_normal(59))
        heading = path.heading[0] + np.append(
            0.0, np.cumsum(turn + 0.02 * np.sqrt(0.1) * rng.standard_normal(59))
        )
        end = np.sum(noisy * np.exp(0.5j * (heading[1:] + heading[:-1]))) * np.exp(-1j * path.heading[0])
        samples.append([end.real, end.imag, heading[-1]])
    result = np.cov(np.array(samples).T)
    # With 4000 draws the standard error of a variance is 2.2 %; the tolerance is four of them.
    assert np.allclose(np.diag(result), np.diag(expected), rtol=0.09)
    scale = np.sqrt(np.diag(expected))
    assert np.allclose(result / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.09)


def test_odometry_at_a_higher_rate_has_the_same_segment_covariance():
    path = wiggly_path(np.random.default_rng(11), 100)
    fine_t = np.linspace(path.t[0], path.t[-1], 991)
    fine = Track(fine_t, *(np.interp(fine_t, path.t, v) for v in (path.x, path.y, path.heading)))
    ends = np.array([path.t[0], 4.05, path.t[-1]])
    covariance_of_coarse, covariance_of_fine = (
        segment_odometry(p, ends, StepNoise()).steps.covariance for p in (path, fine)
    )
    assert np.allclose(covariance_of_coarse, covariance_of_fine, rtol=0.02, atol=1e-9)


STRAIGHT = Track(0.5 * np.arange(5.0), 2.0 * np.arange(5.0), np.zeros(5), np.zeros(5))
ENDS = np.array([0.0, 0.75, 2.0])


def test_the_inflation_of_a_step_divided_by_a_pose_is_split_in_proportion_to_time():
    """Variances add up on a straight path: 1.5 and 2.5 of four steps, beside the noise of rolling wheels."""
    inflated = replace(STRAIGHT, step_inflation=np.array([1.0, 2.0, 4.0, 8.0]))
    for factors in ((1.0, 1.0, 1.0), (2.0, 3.0, 1.0)):
        plain, with_inflation = (
            segment_odometry(path, ENDS, StepNoise(sigma_factors=factors)).steps
            for path in (STRAIGHT, inflated)
        )
        added = with_inflation.covariance - plain.covariance
        np.testing.assert_allclose(added[:, 0, 0], [2.0, 13.0])
        np.testing.assert_allclose(added[:, 1, 1], [2.0, 13.0])
        np.testing.assert_allclose(added[:, 2, 2], 0.0, atol=1e-12)
    with pytest.raises(ValueError, match="step_inflation"):
        check_odometry(replace(STRAIGHT, step_inflation=np.zeros(5)))


def test_a_relative_error_applies_to_length_and_turn_of_each_segment():
    """Segments are 3 m and 5 m long and turn by 0.3 rad and 0.5 rad; the error is a tenth."""
    turning = replace(STRAIGHT, heading=0.4 * STRAIGHT.t)
    steps = segment_odometry(turning, ENDS, StepNoise(relative_error=0.1)).steps
    length = 0.1 * np.array([3.0, 5.0])
    for axis, sigma in ((0, length), (1, length), (2, 0.1 * np.array([0.3, 0.5]))):
        np.testing.assert_allclose(np.sqrt(steps.covariance[:, axis, axis]), sigma, rtol=0.02)
    stationary = replace(STRAIGHT, x=np.zeros(5))
    for covariance in segment_odometry(stationary, ENDS, StepNoise(relative_error=0.1)).steps.covariance:
        assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_an_odometry_outage_adds_the_variance_of_a_brownian_bridge():
    """A Brownian bridge over T seconds has an integral of variance T³ / 12; other noise adds."""
    path = Track(np.array([0.0, 0.1, 4.1]), np.array([0.0, 0.2, 3.2]), np.zeros(3), np.zeros(3))
    noise = StepNoise(
        along=0.3, sideways=0.2, heading=0.02, heading_per_distance=0.05, speed_walk=0.7, yaw_walk=0.4
    )
    regular, across_outage = segment_odometry(path, path.t, noise).steps.covariance
    for result, distance, duration, bridge in (
        (regular, 0.2, 0.1, 0.0),
        (across_outage, 3.0, 4.0, 4.0**3 / 12.0),
    ):
        heading_variance = 0.02**2 * duration + 0.05**2 * distance + 0.4**2 * bridge
        assert result[0, 0] == pytest.approx(0.3**2 * distance + 0.7**2 * bridge, rel=1e-6)
        assert result[2, 2] == pytest.approx(heading_variance, rel=1e-6)
        # A turn within the step rotates half of it.
        assert result[1, 1] == pytest.approx(
            0.2**2 * distance + (0.5 * distance) ** 2 * heading_variance, rel=1e-5
        )
