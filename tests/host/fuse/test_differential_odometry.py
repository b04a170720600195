"""Differential odometry against paths known in closed form, and its covariance against many noisy drives."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.fuse.differential_odometry import (
    DifferentialOdometry,
    OdometryConfig,
    SampleOutcome,
    integrate_wheels,
)
from hubodo.fuse.rolling_wheel import OdometryNoise, WheelSamples, WheelSpec
from hubodo.units import NS_PER_S

T0 = 1_700_000_000 * NS_PER_S
R, B = 0.3, 0.9
FORWARD, TURN = 1.5, 0.25
G = 9.80665


def config(**kwargs):
    left = WheelSpec(R, kwargs.pop("left_facing", "left"), *kwargs.pop("left_bias", ()))
    right = WheelSpec(R, kwargs.pop("right_facing", "left"), *kwargs.pop("right_bias", ()))
    return OdometryConfig(left, right, B, **{"estimate_bias": False, **kwargs})


def wheel(side, seconds, rate, *, hz=200.0, facing="left", start=0.0, bias=0.0, noise=0.0, rng=None):
    """Return samples of a wheel at `rate(t)` rad/s; gravity rotates in its plane."""
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


def pair(seconds, speed, yaw, **kwargs):
    """Return samples of both wheels of a vehicle with v(t), r(t): v_w = v - r y_w, y_w = ±B/2."""
    return (
        wheel("left", seconds, lambda t: (speed(t) - yaw(t) * B / 2) / R, **kwargs),
        wheel("right", seconds, lambda t: (speed(t) + yaw(t) * B / 2) / R, **kwargs),
    )


def drive(cfg, *wheels):
    odometry = DifferentialOdometry(cfg)
    states = [state for samples in wheels for state in odometry.add_samples(samples).states]
    return states + list(odometry.finish())


def split(samples, size):
    for k in range(0, len(samples.t_ns), size):
        part = slice(k, k + size)
        yield WheelSamples(samples.side, samples.t_ns[part], samples.gyro[part], samples.accel[part])


def test_a_straight_drive_has_the_length_of_speed_times_time():
    last = drive(config(), *pair(10, lambda t: FORWARD, lambda t: 0.0))[-1]
    seconds = (last.t_ns - T0) / NS_PER_S
    assert last.x == pytest.approx(FORWARD * seconds, abs=1e-9)
    assert last.y == last.heading == 0.0
    assert last.speed == pytest.approx(FORWARD)


def test_a_circle_closes_on_the_left_and_the_midpoint_rule_leaves_the_chord_error_only():
    seconds = 2 * math.pi / TURN
    last = drive(config(), *pair(seconds + 0.01, lambda t: FORWARD, lambda t: TURN))[-1]
    assert last.heading == pytest.approx(2 * math.pi, abs=TURN * 0.011)
    chord = (TURN * 0.01) ** 2 / 24 * FORWARD * seconds
    assert math.hypot(last.x, last.y) < FORWARD * 0.02 + chord
    quarter = drive(config(), *pair(seconds / 4 + 1e-6, lambda t: FORWARD, lambda t: TURN))[-1]
    assert quarter.x == pytest.approx(FORWARD / TURN, abs=0.02)
    assert quarter.y == pytest.approx(FORWARD / TURN, abs=0.02)  # anticlockwise goes to the left: y > 0


@pytest.mark.parametrize("left", ["left", "right"])
@pytest.mark.parametrize("right", ["left", "right"])
def test_the_facing_of_a_node_only_changes_the_sign_of_its_gyro(left, right):
    a = wheel("left", 2, lambda t: 4.0, facing=left)
    b = wheel("right", 2, lambda t: 5.0, facing=right)
    last = drive(config(left_facing=left, right_facing=right), a, b)[-1]
    assert last.speed == pytest.approx(4.5 * R)
    assert last.yaw_rate == pytest.approx(1.0 * R / B)


@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 4))
def test_batch_sizes_and_order_of_arrival_do_not_change_the_track(n_left, n_right, seed):
    a, b = pair(1.0, lambda t: 1 + t, lambda t: 0.3 * t)
    full = drive(config(), a, b)
    parts = [*split(a, n_left)], [*split(b, n_right)]
    rng = np.random.default_rng(seed)
    mixed = []
    queues = [list(p) for p in parts]
    while any(queues):
        queue = queues[int(rng.integers(2))]
        if queue:
            mixed.append(queue.pop(0))
    assert drive(config(), *mixed) == full


@given(st.integers(-(10**9), 10**9))
def test_a_shift_by_whole_steps_changes_the_time_stamps_only(steps):
    a, b = pair(0.5, lambda t: 1.0, lambda t: 0.2)
    shift = steps * 10_000_000
    shifted = [WheelSamples(w.side, w.t_ns + shift, w.gyro, w.accel) for w in (a, b)]
    one, two = drive(config(), a, b), drive(config(), *shifted)
    assert [s.t_ns + shift for s in one] == [s.t_ns for s in two]
    assert [(s.x, s.y, s.heading) for s in one] == [(s.x, s.y, s.heading) for s in two]


def test_left_and_right_swapped_mirror_the_track():
    a, b = pair(3, lambda t: 1.0, lambda t: 0.4)
    mirrored = (WheelSamples("left", b.t_ns, b.gyro, b.accel), WheelSamples("right", a.t_ns, a.gyro, a.accel))
    one, two = drive(config(), a, b)[-1], drive(config(), *mirrored)[-1]
    assert (one.x, -one.y, -one.heading) == pytest.approx((two.x, two.y, two.heading))


def test_wheels_with_different_rates_and_phases_agree():
    a = wheel("left", 5, lambda t: 4.0, hz=416.0, start=0.0013)
    b = wheel("right", 5, lambda t: 4.0, hz=104.0, start=0.0047)
    states = drive(config(), a, b)
    assert max(abs(s.heading) for s in states) < 1e-9
    assert np.diff([s.t_ns for s in states]).tolist() == [10_000_000] * (len(states) - 1)


def test_samples_of_one_wheel_wait_for_the_other():
    a, b = pair(2, lambda t: 1.0, lambda t: 0.0)
    odometry = DifferentialOdometry(config())
    assert odometry.add_samples(a).outcome is SampleOutcome.WAITING
    assert odometry.state() is None
    handled = odometry.add_samples(b)
    assert handled.outcome is SampleOutcome.ADVANCED
    assert handled.states[-1] == odometry.state()


def test_samples_that_are_not_newer_are_dropped_and_reported_as_late():
    a, b = pair(1, lambda t: 1.0, lambda t: 0.0)
    odometry = DifferentialOdometry(config())
    odometry.add_samples(a)
    assert odometry.add_samples(a).outcome is SampleOutcome.LATE
    assert odometry.add_samples(b).states[-1].x == pytest.approx(0.99, abs=0.02)


def test_a_gap_is_bridged_by_the_chord_with_increased_variance():
    a, b = pair(10, lambda t: FORWARD, lambda t: 0.0)
    hole = (a.t_ns < T0 + 4 * NS_PER_S) | (a.t_ns > T0 + 6 * NS_PER_S)
    holed = WheelSamples("left", a.t_ns[hole], a.gyro[hole], a.accel[hole])
    full, bridged = drive(config(), a, b)[-1], drive(config(), holed, b)[-1]
    assert bridged.x == pytest.approx(full.x, abs=1e-9)
    # A Brownian bridge of 2 s at 1 m/s per sqrt(s) leaves 2^3 / 12 m2 on one wheel.
    extra = bridged.covariance[2][2] - full.covariance[2][2]
    assert extra == pytest.approx(2.0**3 / 12 / B**2, rel=0.02)


def test_a_gyro_bias_is_estimated_at_standstill_and_corrected_from_the_first_sample_on():
    rng = np.random.default_rng(11)

    def speed(t):
        return 0.0 if t < 3 else 1.0

    a = wheel("left", 13, lambda t: speed(t) / R, bias=0.05, noise=0.004, rng=rng)
    b = wheel("right", 13, lambda t: speed(t) / R, bias=-0.08, noise=0.004, rng=rng)
    odometry = DifferentialOdometry(config(estimate_bias=True))
    last = None
    for x, y in zip(split(a, 8), split(b, 8), strict=True):
        odometry.add_samples(x)
        last = odometry.add_samples(y).states[-1:] or last
    biases = odometry.biases()
    assert biases["left"][0] == pytest.approx(0.05, abs=3 * biases["left"][1])
    assert biases["right"][0] == pytest.approx(-0.08, abs=3 * biases["right"][1])
    assert last[0].x == pytest.approx(10.0, abs=0.03)
    assert abs(last[0].heading) < 0.02
    naive = drive(config(), a, b)[-1]
    assert abs(naive.heading) > 0.3  # what the bias would have done


def test_slow_rolling_is_not_a_standstill():
    a, b = pair(20, lambda t: 0.03, lambda t: 0.0)
    odometry = DifferentialOdometry(config(estimate_bias=True))
    odometry.add_samples(a)
    odometry.add_samples(b)
    assert odometry.biases()["left"][0] == 0.0
    assert odometry.state().x == pytest.approx(0.6, abs=0.01)


def test_the_covariance_covers_many_noisy_drives():
    """The normalised squared errors of 50 drives, 3 degrees of freedom each, sum to a chi-square(150)."""
    noise = OdometryNoise(
        gyro=0.02, road=0.0, lateral=0.0, speed_walk=0.0, radius=0.005, radius_each=0.002, track=0.01
    )
    cfg = config(noise=noise, left_bias=(0.0, 0.002), right_bias=(0.0, 0.002))
    silent = pair(12, lambda t: 1.0, lambda t: 0.3 * math.sin(0.4 * t))
    truth = drive(cfg, *silent)[-1]
    total, seed = 0.0, 4
    rng = np.random.default_rng(seed)
    for _ in range(50):
        both, track = rng.normal(0, 0.005), 1 + rng.normal(0, 0.01)
        output = []
        for side, samples in zip(("left", "right"), silent, strict=True):
            scale = 1 + both + rng.normal(0, 0.002)
            gyro = samples.gyro * scale + rng.normal(0, 0.002)
            gyro[:, 2] += rng.normal(0, 0.02, len(gyro))
            output.append(WheelSamples(side, samples.t_ns, gyro, samples.accel))
        off = OdometryConfig(cfg.left, cfg.right, B * track, estimate_bias=False, noise=noise)
        last = drive(off, *output)[-1]
        error = np.array([last.x - truth.x, last.y - truth.y, last.heading - truth.heading])
        total += float(error @ np.linalg.solve(np.array(truth.covariance), error))
    # 99.9 % of chi-square(150) lies within 99.5 to 213.6.
    assert 99.5 < total < 213.6, f"seed {seed}"


CONSTANTS = ("radius", "radius_each", "track", "left_bias", "right_bias")


def constants_off(cfg, name, by):
    """Return the configuration with one constant changed; for `radius_each` that of the left wheel."""
    left, right, track = cfg.left, cfg.right, cfg.track_width
    if name.startswith("radius"):
        left = replace(left, radius=left.radius * (1 + by))
    if name == "radius":
        right = replace(right, radius=right.radius * (1 + by))
    if name == "left_bias":
        left = replace(left, gyro_bias=by)
    if name == "right_bias":
        right = replace(right, gyro_bias=by)
    if name == "track":
        track *= 1 + by
    return replace(cfg, left=left, right=right, track_width=track)


@pytest.mark.parametrize("name", CONSTANTS)
def test_the_covariance_by_a_constant_error_is_that_of_the_pose_derivative(name):
    """Steps of half a second with large turns are compared with central differences."""
    silent = dict.fromkeys(("gyro", "road", "lateral", "speed_walk", "radius", "radius_each", "track"), 0.0)
    sigma = 0.01
    noise = OdometryNoise(**silent | ({name: sigma} if name in silent else {}))
    known = {f"{side}_bias": (0.0, sigma if name == f"{side}_bias" else 0.0) for side in ("left", "right")}
    cfg = config(noise=noise, step_ns=NS_PER_S // 2, **known)
    wheels = pair(8, lambda t: 1 + 0.2 * t, lambda t: 0.8 * math.sin(0.5 * t))

    def pose(by, which=name):
        last = drive(constants_off(cfg, which, by), *wheels)[-1]
        return np.array([last.x, last.y, last.heading])

    by = 1e-5
    slopes = [(pose(by) - pose(-by)) / (2 * by)]
    if name == "radius_each":  # the other wheel's is as free
        slopes.append((pose(by, "radius") - pose(-by, "radius")) / (2 * by) - slopes[0])
    expected = sigma**2 * sum(np.outer(slope, slope) for slope in slopes)
    covariance = np.array(drive(cfg, *wheels)[-1].covariance)
    assert covariance == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_on_a_straight_path_a_heading_random_walk_causes_lateral_variance():
    """Heading variance q per metre gives q L at the end, q L^3 / 3 lateral, q L^2 / 2 cross-covariance."""
    noise = OdometryNoise(
        gyro=0.0, road=0.01, lateral=0.0, speed_walk=0.0, radius=0.0, radius_each=0.0, track=0.0
    )
    known = config(noise=noise, left_bias=(0.0, 0.0), right_bias=(0.0, 0.0))
    last = drive(known, *pair(0.2, lambda t: FORWARD, lambda t: 0.0))[-1]
    (xx, xy, xh), (_, yy, yh), (_, _, hh) = last.covariance
    assert hh == pytest.approx(2 * 0.01**2 * last.x / B**2)
    # Chords of 10 ms instead of the integral: off by 1 / 4 n^2.
    assert yy == pytest.approx(hh * last.x**2 / 3, rel=2e-3)
    assert yh == pytest.approx(hh * last.x / 2, rel=2e-3)
    # Common and independent errors of two wheels: their mean, and their difference over the track width.
    assert xx == pytest.approx(hh * B**2 / 4) and xy == xh == 0.0
    (speed, cross), (_, yaw_rate) = last.twist_covariance
    assert yaw_rate == pytest.approx(speed * 4 / B**2) and cross == 0.0


def test_a_long_outage_of_one_wheel_does_not_fill_the_memory(monkeypatch):
    monkeypatch.setattr("hubodo.fuse.rolling_wheel._MAX_KNOTS", 1 << 13)
    odometry = DifferentialOdometry(config())
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
    a, b = pair(12, lambda t: 1 + 0.1 * t, lambda t: 0.3 * math.sin(t))
    full = drive(config(), a, b)
    monkeypatch.setattr("hubodo.fuse.rolling_wheel._MAX_KNOTS", 500)
    assert integrate_wheels(config(), [a, b]) == full
    assert integrate_wheels(config(), []) == []
