"""One rolling wheel: distance, variance, and gyro bias at standstill; noise propagation in the odometry."""

import math

import numpy as np
import pytest

from hubodo.fuse.differential_odometry import DifferentialOdometry, OdometryConfig
from hubodo.fuse.rolling_wheel import OdometryNoise, RollingWheel, StandstillBlocks, WheelSamples, WheelSpec

S, G = 1_000_000_000, 9.80665
R, B = 0.3, 0.9
NONE = OdometryNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def samples(t, rate, side="left", turned=0.0):
    """Return samples of one wheel; turned: rad by which gravity has rotated at each time."""
    count = len(t)
    gyro, accel = np.zeros((2, count, 3))
    gyro[:, 2] = rate
    accel[:, 0], accel[:, 1] = G * np.cos(turned), -G * np.sin(turned)
    return WheelSamples(side, np.round(np.asarray(t) * S).astype(np.int64), gyro, accel)


def make_wheel(noise=NONE, estimate_bias=False, facing="left", **spec):
    return RollingWheel(WheelSpec(R, facing, **spec), noise, estimate_bias)


def test_distance_and_variance_are_the_integrals_of_rate_and_noise():
    """Noise terms: gyro, road in either direction, and a random walk of the speed."""
    t = np.cumsum(np.random.default_rng(2).uniform(0.002, 0.2, 60))
    rate = 4.0 * np.sin(2.0 * t)
    step = np.diff(t)
    distance = R * 0.5 * (rate[1:] + rate[:-1]) * step
    for noise, variance in (
        (OdometryNoise(0.02, 0.0, 0.0, 0.0), (R * 0.02 * step) ** 2),
        (OdometryNoise(0.0, 0.03, 0.0, 0.0), 0.03**2 * np.abs(distance)),
        (OdometryNoise(0.0, 0.0, 0.0, 0.7), 0.7**2 * step**3 / 12.0),
    ):
        rolling_wheel = make_wheel(noise)
        assert rolling_wheel.add_samples(samples(t, rate)) == 0
        times, distances, variances = np.transpose(rolling_wheel.knots)
        assert times == pytest.approx(t * S, abs=1.0)
        assert distances == pytest.approx(np.append(0.0, np.cumsum(distance)), abs=1e-8)
        assert variances == pytest.approx(np.append(0.0, np.cumsum(variance)), rel=1e-6, abs=1e-15)
    right_facing = make_wheel(facing="right", gyro_bias=0.1)
    right_facing.add_samples(samples(t, -rate + 0.1))
    assert right_facing.knots[-1][1] == pytest.approx(np.sum(distance))


def test_distance_is_linear_between_knots_and_older_knots_are_dropped():
    rolling_wheel = make_wheel(OdometryNoise(0.02, 0.0, 0.0, 0.0))
    rolling_wheel.add_samples(samples([0.0, 1.0, 3.0, 4.0], [2.0, 2.0, 4.0, 4.0]))
    distances, variances = (
        R * np.array([0.0, 2.0, 8.0, 12.0]),
        (R * 0.02) ** 2 * np.array([0.0, 1.0, 5.0, 6.0]),
    )
    for t in (0.0, 0.25, 1.0, 1.5, 3.0, 4.0):
        expected = [np.interp(t, [0.0, 1.0, 3.0, 4.0], column) for column in (distances, variances)]
        assert rolling_wheel.distance_at(round(t * S)) == pytest.approx(expected)
    assert [knot[0] for knot in rolling_wheel.knots] == [4 * S]
    assert rolling_wheel.distance_at(4 * S) == pytest.approx((distances[-1], variances[-1]))


def test_samples_that_are_not_newer_are_counted_and_dropped():
    rolling_wheel = make_wheel()
    assert rolling_wheel.add_samples(samples([0.0, 1.0, 1.0, 0.5, 2.0], [1.0, 1.0, 50.0, 50.0, 1.0])) == 2
    assert rolling_wheel.knots[-1][:2] == (2 * S, pytest.approx(2.0 * R))
    assert rolling_wheel.newest_t_ns == 2 * S


def test_with_too_many_knots_every_second_one_and_the_newest_remain(monkeypatch):
    monkeypatch.setattr("hubodo.fuse.rolling_wheel._MAX_KNOTS", 10)
    for count in (10, 11, 12):
        rolling_wheel = make_wheel()
        rolling_wheel.add_samples(samples(np.arange(float(count)), np.ones(count)))
        retained = [knot[0] // S for knot in rolling_wheel.knots]
        assert retained == (
            list(range(count)) if count == 10 else sorted({*range(0, count - 1, 2), count - 1})
        )


def wheel_at_rate(rate, seconds=0.6, hz=100.0, **options):
    rolling_wheel = make_wheel(estimate_bias=True, **options)
    t = 5.0 + np.arange(0.0, seconds, 1.0 / hz)
    rolling_wheel.add_samples(samples(t, np.full(len(t), rate)))
    return rolling_wheel


@pytest.mark.parametrize("sigma", [0.05, 3e-4])
@pytest.mark.parametrize("facing", ["left", "right"])
def test_half_a_second_of_standstill_measures_the_bias_and_corrects_the_distance(sigma, facing):
    """The measurement sigma is a bias instability of 40 deg/h; half a second of random walk is added."""
    rolling_wheel = wheel_at_rate(0.01, gyro_bias=0.002, gyro_bias_sigma=sigma, facing=facing)
    gain = sigma**2 / (sigma**2 + 2e-4**2)
    bias = 0.002 + gain * 0.008
    assert rolling_wheel.bias == pytest.approx(bias, rel=1e-6)
    assert rolling_wheel.bias_sigma == pytest.approx(
        math.sqrt(sigma**2 * 2e-4**2 / (sigma**2 + 2e-4**2) + 2e-5**2 * 0.5), rel=1e-6
    )
    sign = 1.0 if facing == "left" else -1.0
    times, distances, _ = np.transpose(rolling_wheel.knots)
    assert distances == pytest.approx(sign * R * (0.01 - bias) * (times / S - 5.0), abs=1e-9)


def test_a_wheel_is_initialised_after_its_first_block_stationary_or_not():
    for seconds, ready in ((0.49, False), (0.52, True)):
        assert wheel_at_rate(0.01, seconds).is_initialised == ready
    moving_wheel = wheel_at_rate(1.0)
    assert moving_wheel.is_initialised and moving_wheel.bias == 0.0 and moving_wheel.bias_sigma == 0.05
    assert make_wheel().is_initialised
    # A later standstill does not change the distance rolled before.
    rolling_wheel = make_wheel(estimate_bias=True)
    t = np.arange(0.0, 1.05, 0.01)
    rolling_wheel.add_samples(samples(t, np.where(t < 0.5, 2.0, 0.01)))
    assert rolling_wheel.bias == pytest.approx(0.01, rel=1e-3)
    half = next(knot[1] for knot in rolling_wheel.knots if knot[0] == round(0.49 * S))
    assert half == pytest.approx(R * 2.0 * 0.49)


def classify_block(rate, gravity_angle=0.0, count=50):
    """Return the classified block of 0.5 s in two halves, with `count` samples."""
    block = StandstillBlocks()
    t = np.arange(count + 1) / count * 0.5
    reported = [
        block.add_sample(round(stamp * S), float(r), G * math.cos(a), -G * math.sin(a))
        for stamp, r, a in zip(t, *np.broadcast_arrays(rate, gravity_angle, t)[:2], strict=True)
    ]
    assert reported == [False] * count + [True]
    return block


def test_a_wheel_is_stationary_where_gyro_and_gravity_are_steady():
    for rate, stationary in ((0.349, True), (0.351, False), (-0.349, True), (-0.351, False)):
        assert classify_block(rate).is_stationary == stationary
    ripple = (-1.0) ** np.arange(51)
    for size, stationary in ((0.0195, True), (0.0205, False)):
        block = classify_block(0.1 + size * ripple)
        assert block.is_stationary == stationary
        assert block.mean == pytest.approx(0.1, abs=1e-12)
        # The variance of the mean of 50 samples, and of the bias instability.
        assert block.variance == pytest.approx(size**2 / 50 + 2e-4**2)
    second = np.arange(51) >= 25
    for sign in (1.0, -1.0):
        for turned, stationary in ((0.0049, True), (0.0051, False)):
            for start_angle in (0.0, 1.3):
                assert classify_block(0.1, start_angle + sign * turned * second).is_stationary == stationary
    for count, stationary in ((10, True), (8, False)):
        assert classify_block(0.1, count=count).is_stationary == stationary


def run_odometry(wheels, noise, step):
    odometry = DifferentialOdometry(
        OdometryConfig(WheelSpec(R, "left", 0.0, 0.0), WheelSpec(R, "left", 0.0, 0.0), B, step, False, noise)
    )
    return [state for wheel in wheels for state in odometry.add_samples(wheel).states]


def test_step_noise_propagates_to_the_pose_as_numerical_differences():
    """Road noise of each wheel and lateral slip of the vehicle, in steps that are bends."""
    road, lateral, step = 0.02, 0.03, 0.5
    t = np.arange(0.0, 6.01, step)
    rates = np.array([2.0 + 0.5 * np.sin(t), 3.0 + np.cos(1.3 * t)])
    noise = OdometryNoise(0.0, road, lateral, 0.0, 0.0, 0.0, 0.0)
    last = run_odometry([samples(t, rates[0]), samples(t, rates[1], "right")], noise, S // 2)[-1]
    distances = R * 0.5 * step * (rates[:, 1:] + rates[:, :-1])

    def pose(error):
        x = y = heading = 0.0
        for (left, right), (more_left, more_right, sideways) in zip(
            distances.T, error.reshape(-1, 3), strict=True
        ):
            left, right = left + more_left, right + more_right
            turn, distance = (right - left) / B, 0.5 * (left + right)
            middle = heading + 0.5 * turn
            x += distance * math.cos(middle) - sideways * math.sin(middle)
            y += distance * math.sin(middle) + sideways * math.cos(middle)
            heading += turn
        return np.array([x, y, heading])

    size = 3 * distances.shape[1]
    assert (last.x, last.y, last.heading) == pytest.approx(pose(np.zeros(size)))
    derivatives = np.array([(pose(1e-6 * unit) - pose(-1e-6 * unit)) / 2e-6 for unit in np.eye(size)])
    variances = np.column_stack([*(road**2 * distances), lateral**2 * 0.5 * distances.sum(axis=0)])
    expected = derivatives.T @ np.diag(variances.ravel()) @ derivatives
    np.testing.assert_allclose(last.covariance, expected, rtol=1e-6, atol=1e-12)
    # Means over the last step.
    mean = np.array([[0.5, 0.5], [-1.0 / B, 1.0 / B]]) / step
    twist = mean @ np.diag(variances[-1, :2]) @ mean.T
    np.testing.assert_allclose(last.twist_covariance, twist, rtol=1e-6)
    assert (last.speed, last.yaw_rate) == pytest.approx(tuple(mean @ distances[:, -1]))


def test_poses_start_at_the_first_step_with_samples_of_both_wheels():
    t = np.arange(0.0, 1.0, 0.01)
    for delay, first in ((0.333, 0.34), (0.0, 0.0)):
        for sides in (("left", "right"), ("right", "left")):
            wheels = [samples(t, np.ones(100), sides[0]), samples(t + delay, np.ones(100), sides[1])]
            states = run_odometry(wheels, NONE, S // 100)
            assert states[0].t_ns == round(first * S)
            assert states[0].distance == states[0].x == 0.0
            assert states[-1].t_ns == round(0.99 * S)
            assert states[-1].distance == pytest.approx(R * (0.99 - first))
    without_overlap = [samples(t, np.ones(100)), samples(t + 1.0, np.ones(100), "right")]
    assert run_odometry(without_overlap, NONE, S // 100) == []
