"""Differential odometry against closed-form paths, and its covariance against many noisy drives."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from hubodo.fuse.differential_odometry import (
    DifferentialOdometry,
    OdometryConfig,
    SampleOutcome,
    integrate_wheels,
)
from hubodo.fuse.rolling_wheel import OdometryNoise, WheelSamples, WheelSpec
from hubodo.units import NS_PER_S
from repetitions import first_and_more

T0 = 1_700_000_000 * NS_PER_S
R, B = 0.3, 0.9
FORWARD, TURN = 1.5, 0.25
G = 9.80665


def make_config(**kwargs):
    left = WheelSpec(R, kwargs.pop("left_facing", "left"), *kwargs.pop("left_bias", ()))
    right = WheelSpec(R, kwargs.pop("right_facing", "left"), *kwargs.pop("right_bias", ()))
    return OdometryConfig(left, right, B, **{"estimate_bias": False, **kwargs})


def wheel_samples(side, seconds, rate, *, hz=200.0, facing="left", start=0.0, bias=0.0, noise=0.0, rng=None):
    """Return samples of a wheel that turns at `rate(t)`, rad/s; gravity rotates in its plane."""
    t = np.arange(start, seconds, 1 / hz)
    spin = np.array([rate(x) for x in t])
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (spin[1:] + spin[:-1])) / hz])
    sign = 1.0 if facing == "left" else -1.0
    gyro = np.zeros((len(t), 3))
    gyro[:, 2] = sign * spin + bias
    accel = np.column_stack([G * np.cos(angle), -sign * G * np.sin(angle), np.zeros(len(t))])
    if rng is not None:
        gyro[:, 2] += rng.normal(0, noise, len(t))
        accel += rng.normal(0, 0.05, accel.shape)
    return WheelSamples(side, T0 + np.round(t * NS_PER_S).astype(np.int64), gyro, accel)


def wheel_pair(seconds, speed, yaw, **kwargs):
    """Return samples of both wheels of a vehicle with speed(t) and yaw(t): v_w = v - r y_w, y_w = ±B/2."""
    return (
        wheel_samples("left", seconds, lambda t: (speed(t) - yaw(t) * B / 2) / R, **kwargs),
        wheel_samples("right", seconds, lambda t: (speed(t) + yaw(t) * B / 2) / R, **kwargs),
    )


def run_odometry(cfg, *wheels):
    odometry = DifferentialOdometry(cfg)
    states = [state for samples in wheels for state in odometry.add_samples(samples).states]
    return states + list(odometry.finish())


def split_samples(samples, size):
    for k in range(0, len(samples.t_ns), size):
        part = slice(k, k + size)
        yield WheelSamples(samples.side, samples.t_ns[part], samples.gyro[part], samples.accel[part])


def test_a_straight_drive_has_the_length_of_speed_times_time():
    last = run_odometry(make_config(), *wheel_pair(10, lambda t: FORWARD, lambda t: 0.0))[-1]
    seconds = (last.t_ns - T0) / NS_PER_S
    assert last.x == pytest.approx(FORWARD * seconds, abs=1e-9)
    assert last.y == last.heading == 0.0
    assert last.speed == pytest.approx(FORWARD)


def test_a_left_circle_closes_up_to_the_chord_error_of_the_midpoint_rule():
    seconds = 2 * math.pi / TURN
    last = run_odometry(make_config(), *wheel_pair(seconds + 0.01, lambda t: FORWARD, lambda t: TURN))[-1]
    assert last.heading == pytest.approx(2 * math.pi, abs=TURN * 0.011)
    chord = (TURN * 0.01) ** 2 / 24 * FORWARD * seconds
    assert math.hypot(last.x, last.y) < FORWARD * 0.02 + chord
    quarter = run_odometry(make_config(), *wheel_pair(seconds / 4 + 1e-6, lambda t: FORWARD, lambda t: TURN))[
        -1
    ]
    assert quarter.x == pytest.approx(FORWARD / TURN, abs=0.02)
    assert quarter.y == pytest.approx(FORWARD / TURN, abs=0.02)  # anticlockwise, so to the left: y > 0


@pytest.mark.parametrize("left", ["left", "right"])
@pytest.mark.parametrize("right", ["left", "right"])
def test_the_facing_of_a_node_only_changes_the_sign_of_its_gyro(left, right):
    a = wheel_samples("left", 2, lambda t: 4.0, facing=left)
    b = wheel_samples("right", 2, lambda t: 5.0, facing=right)
    last = run_odometry(make_config(left_facing=left, right_facing=right), a, b)[-1]
    assert last.speed == pytest.approx(4.5 * R)
    assert last.yaw_rate == pytest.approx(1.0 * R / B)


@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 4))
def test_batch_sizes_and_order_of_arrival_do_not_change_the_track(n_left, n_right, seed):
    a, b = wheel_pair(1.0, lambda t: 1 + t, lambda t: 0.3 * t)
    full = run_odometry(make_config(), a, b)
    parts = [*split_samples(a, n_left)], [*split_samples(b, n_right)]
    rng = np.random.default_rng(seed)
    interleaved = []
    queues = [list(p) for p in parts]
    while any(queues):
        queue = queues[int(rng.integers(2))]
        if queue:
            interleaved.append(queue.pop(0))
    assert run_odometry(make_config(), *interleaved) == full


@given(st.integers(-(10**9), 10**9))
def test_a_shift_by_whole_steps_changes_the_time_stamps_only(steps):
    a, b = wheel_pair(0.5, lambda t: 1.0, lambda t: 0.2)
    shift = steps * 10_000_000
    shifted = [WheelSamples(w.side, w.t_ns + shift, w.gyro, w.accel) for w in (a, b)]
    one, two = run_odometry(make_config(), a, b), run_odometry(make_config(), *shifted)
    assert [s.t_ns + shift for s in one] == [s.t_ns for s in two]
    assert [(s.x, s.y, s.heading) for s in one] == [(s.x, s.y, s.heading) for s in two]


def test_swapping_left_and_right_mirrors_the_track():
    a, b = wheel_pair(3, lambda t: 1.0, lambda t: 0.4)
    mirrored = (WheelSamples("left", b.t_ns, b.gyro, b.accel), WheelSamples("right", a.t_ns, a.gyro, a.accel))
    one, two = run_odometry(make_config(), a, b)[-1], run_odometry(make_config(), *mirrored)[-1]
    assert (one.x, -one.y, -one.heading) == pytest.approx((two.x, two.y, two.heading))


def test_wheels_with_different_rates_and_phases_agree():
    a = wheel_samples("left", 5, lambda t: 4.0, hz=416.0, start=0.0013)
    b = wheel_samples("right", 5, lambda t: 4.0, hz=104.0, start=0.0047)
    states = run_odometry(make_config(), a, b)
    assert max(abs(s.heading) for s in states) < 1e-9
    assert np.diff([s.t_ns for s in states]).tolist() == [10_000_000] * (len(states) - 1)


def test_samples_of_one_wheel_wait_for_the_other():
    a, b = wheel_pair(2, lambda t: 1.0, lambda t: 0.0)
    odometry = DifferentialOdometry(make_config())
    assert odometry.add_samples(a).outcome is SampleOutcome.WAITING
    assert odometry.state() is None
    handled = odometry.add_samples(b)
    assert handled.outcome is SampleOutcome.ADVANCED
    assert handled.states[-1] == odometry.state()


def test_samples_that_are_not_newer_are_dropped_and_reported_as_late():
    a, b = wheel_pair(1, lambda t: 1.0, lambda t: 0.0)
    odometry = DifferentialOdometry(make_config())
    odometry.add_samples(a)
    assert odometry.add_samples(a).outcome is SampleOutcome.LATE
    assert odometry.add_samples(b).states[-1].x == pytest.approx(0.99, abs=0.02)


def test_a_gap_is_bridged_at_constant_speed_with_increased_variance():
    a, b = wheel_pair(10, lambda t: FORWARD, lambda t: 0.0)
    received = (a.t_ns < T0 + 4 * NS_PER_S) | (a.t_ns > T0 + 6 * NS_PER_S)
    with_gap = WheelSamples("left", a.t_ns[received], a.gyro[received], a.accel[received])
    full, bridged = run_odometry(make_config(), a, b)[-1], run_odometry(make_config(), with_gap, b)[-1]
    assert bridged.x == pytest.approx(full.x, abs=1e-9)
    # A Brownian bridge of 2 s at 1 m/s per sqrt(s) leaves 2^3 / 12 m2 on one wheel.
    added = bridged.covariance[2][2] - full.covariance[2][2]
    assert added == pytest.approx(2.0**3 / 12 / B**2, rel=0.02)


def test_a_gyro_bias_is_estimated_at_standstill_and_corrected_from_the_first_sample_on():
    rng = np.random.default_rng(11)

    def speed(t):
        return 0.0 if t < 3 else 1.0

    a = wheel_samples("left", 13, lambda t: speed(t) / R, bias=0.05, noise=0.004, rng=rng)
    b = wheel_samples("right", 13, lambda t: speed(t) / R, bias=-0.08, noise=0.004, rng=rng)
    odometry = DifferentialOdometry(make_config(estimate_bias=True))
    last = None
    for x, y in zip(split_samples(a, 8), split_samples(b, 8), strict=True):
        odometry.add_samples(x)
        last = odometry.add_samples(y).states[-1:] or last
    biases = odometry.biases()
    assert biases["left"][0] == pytest.approx(0.05, abs=3 * biases["left"][1])
    assert biases["right"][0] == pytest.approx(-0.08, abs=3 * biases["right"][1])
    assert last[0].x == pytest.approx(10.0, abs=0.03)
    assert abs(last[0].heading) < 0.02
    uncorrected = run_odometry(make_config(), a, b)[-1]
    assert abs(uncorrected.heading) > 0.3  # heading error of an uncorrected bias


def test_slow_rolling_is_not_a_standstill():
    a, b = wheel_pair(20, lambda t: 0.03, lambda t: 0.0)
    odometry = DifferentialOdometry(make_config(estimate_bias=True))
    odometry.add_samples(a)
    odometry.add_samples(b)
    assert odometry.biases()["left"][0] == 0.0
    assert odometry.state().x == pytest.approx(0.6, abs=0.01)


@pytest.mark.parametrize("drives", first_and_more(20, 50))
def test_the_covariance_covers_many_noisy_drives(drives):
    """The normalised squared errors of drives, 3 degrees of freedom each, sum to a chi-square."""
    noise = OdometryNoise(
        gyro=0.02, road=0.0, lateral=0.0, speed_walk=0.0, radius=0.005, radius_each=0.002, track=0.01
    )
    cfg = make_config(noise=noise, left_bias=(0.0, 0.002), right_bias=(0.0, 0.002))
    without_noise = wheel_pair(12, lambda t: 1.0, lambda t: 0.3 * math.sin(0.4 * t))
    truth = run_odometry(cfg, *without_noise)[-1]
    total, seed = 0.0, 4
    rng = np.random.default_rng(seed)
    for _ in range(drives):
        common_scale, track = rng.normal(0, 0.005), 1 + rng.normal(0, 0.01)
        wheels = []
        for side, samples in zip(("left", "right"), without_noise, strict=True):
            scale = 1 + common_scale + rng.normal(0, 0.002)
            gyro = samples.gyro * scale + rng.normal(0, 0.002)
            gyro[:, 2] += rng.normal(0, 0.02, len(gyro))
            wheels.append(WheelSamples(side, samples.t_ns, gyro, samples.accel))
        with_errors = OdometryConfig(cfg.left, cfg.right, B * track, estimate_bias=False, noise=noise)
        last = run_odometry(with_errors, *wheels)[-1]
        error = np.array([last.x - truth.x, last.y - truth.y, last.heading - truth.heading])
        total += float(error @ np.linalg.solve(np.array(truth.covariance), error))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * drives)
    assert low < total < high, f"seed {seed}"


CONSTANTS = ("radius", "radius_each", "track", "left_bias", "right_bias")


def config_with_error(cfg, name, error):
    """Return the configuration with an error in one constant; for `radius_each` in that of the left wheel."""
    left, right, track = cfg.left, cfg.right, cfg.track_width
    if name.startswith("radius"):
        left = replace(left, radius=left.radius * (1 + error))
    if name == "radius":
        right = replace(right, radius=right.radius * (1 + error))
    if name == "left_bias":
        left = replace(left, gyro_bias=error)
    if name == "right_bias":
        right = replace(right, gyro_bias=error)
    if name == "track":
        track *= 1 + error
    return replace(cfg, left=left, right=right, track_width=track)


@pytest.mark.parametrize("name", CONSTANTS)
def test_the_covariance_of_a_constant_error_follows_from_the_pose_derivative(name):
    """Compare with central differences for steps of 0.5 s with large turns."""
    zero_noise = dict.fromkeys(
        ("gyro", "road", "lateral", "speed_walk", "radius", "radius_each", "track"), 0.0
    )
    sigma = 0.01
    noise = OdometryNoise(**zero_noise | ({name: sigma} if name in zero_noise else {}))
    biases = {f"{side}_bias": (0.0, sigma if name == f"{side}_bias" else 0.0) for side in ("left", "right")}
    cfg = make_config(noise=noise, step_ns=NS_PER_S // 2, **biases)
    wheels = wheel_pair(8, lambda t: 1 + 0.2 * t, lambda t: 0.8 * math.sin(0.5 * t))

    def pose(error, which=name):
        last = run_odometry(config_with_error(cfg, which, error), *wheels)[-1]
        return np.array([last.x, last.y, last.heading])

    step = 1e-5
    derivatives = [(pose(step) - pose(-step)) / (2 * step)]
    if name == "radius_each":  # the radius error of the right wheel has the same sigma
        derivatives.append((pose(step, "radius") - pose(-step, "radius")) / (2 * step) - derivatives[0])
    expected = sigma**2 * sum(np.outer(derivative, derivative) for derivative in derivatives)
    covariance = np.array(run_odometry(cfg, *wheels)[-1].covariance)
    assert covariance == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_on_a_straight_path_a_heading_random_walk_causes_lateral_variance():
    """Heading variance q per metre over the length L gives q L, lateral q L³ / 3, cross-covariance q L² /
    2.
    """
    noise = OdometryNoise(
        gyro=0.0, road=0.01, lateral=0.0, speed_walk=0.0, radius=0.0, radius_each=0.0, track=0.0
    )
    known_biases = make_config(noise=noise, left_bias=(0.0, 0.0), right_bias=(0.0, 0.0))
    last = run_odometry(known_biases, *wheel_pair(0.2, lambda t: FORWARD, lambda t: 0.0))[-1]
    (xx, xy, xh), (_, yy, yh), (_, _, hh) = last.covariance
    assert hh == pytest.approx(2 * 0.01**2 * last.x / B**2)
    # Chords of 10 ms instead of the integral cause an error of 1 / (4 n²).
    assert yy == pytest.approx(hh * last.x**2 / 3, rel=2e-3)
    assert yh == pytest.approx(hh * last.x / 2, rel=2e-3)
    # The error of the speed is the mean of both wheels, that of the yaw rate their difference over the track
    # width.
    assert xx == pytest.approx(hh * B**2 / 4) and xy == xh == 0.0
    (speed, cross), (_, yaw_rate) = last.twist_covariance
    assert yaw_rate == pytest.approx(speed * 4 / B**2) and cross == 0.0


def test_a_long_outage_of_one_wheel_does_not_fill_the_memory(monkeypatch):
    monkeypatch.setattr("hubodo.fuse.rolling_wheel._MAX_KNOTS", 1 << 13)
    odometry = DifferentialOdometry(make_config())
    for k in range(15):
        t = T0 + (k * 1000 + np.arange(1000, dtype=np.int64)) * 5_000_000
        gyro, accel = np.zeros((1000, 3)), np.zeros((1000, 3))
        gyro[:, 2] = 2.0
        odometry.add_samples(WheelSamples("left", t, gyro, accel))
    assert len(odometry._wheels["left"].knots) <= (1 << 13) + 1000
    t = T0 + np.array([0, 15 * 1000 - 1], np.int64) * 5_000_000
    gyro = np.zeros((2, 3))
    gyro[:, 2] = 2.0
    last = odometry.add_samples(WheelSamples("right", t, gyro, np.zeros((2, 3)))).states[-1]
    assert last.distance == pytest.approx(2.0 * R * (last.t_ns - T0) / NS_PER_S)


def test_a_recording_is_integrated_bit_by_bit_as_live(monkeypatch):
    a, b = wheel_pair(12, lambda t: 1 + 0.1 * t, lambda t: 0.3 * math.sin(t))
    full = run_odometry(make_config(), a, b)
    monkeypatch.setattr("hubodo.fuse.rolling_wheel._MAX_KNOTS", 500)
    assert integrate_wheels(make_config(), [a, b]) == full
    assert integrate_wheels(make_config(), []) == []
