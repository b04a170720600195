"""The forward model of a wheel against a rigid one moved through space and differentiated numerically.

The rigid wheel is written from geometry alone and shares nothing with the model but speed and yaw rate, which
are formulas here and splines there. Its angle is the solution of a differential equation by Runge-Kutta.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from hubodo.effects.mounting import LeverArm
from hubodo.effects.vehicle import RoadGrade, TrackWidth
from hubodo.effects.wheel import TyreGrowth, WheelCamber, WheelEccentricity, WheelRadius, WheelSlip
from hubodo.model.forward import NodeInitialState, NodeModel
from hubodo.model.inputs import EarthRotation, MotionInputs
from hubodo.smoothing_spline import constant_spline, fit_interpolating_spline
from hubodo.vehicle import NodeMount

G = 9.80665
R, B = 0.31, 0.92
SIDES = ["left", "right"]
END = 5.0


def speed(t):
    return 1.1 + 0.5 * np.sin(0.9 * t) + 0.2 * np.cos(2.3 * t)


def pull(t):
    return 0.45 * np.cos(0.9 * t) - 0.46 * np.sin(2.3 * t)


def yaw(t):
    return 0.6 * np.sin(0.8 * t + 0.3) + 0.2 * np.cos(1.9 * t)


def yaw_slope(t):
    return 0.48 * np.cos(0.8 * t + 0.3) - 0.38 * np.sin(1.9 * t)


def driven():
    """Return the same drive as inputs of the model."""
    t = np.arange(0.0, END + 0.2, 0.01)
    return MotionInputs(fit_interpolating_spline(t, speed(t)), fit_interpolating_spline(t, yaw(t)))


class RigidWheel:
    """A wheel with a node, located in the world at any time."""

    def __init__(self, side, facing, effects, start):
        self.left, self.facing = side == "left", facing
        value = {type(e): e for e in effects}

        def get(kind, name):
            return getattr(value[kind], name) if kind in value else 0.0

        self.radius = R * (1 + get(WheelRadius, "error"))
        self.half = B * (1 + get(TrackWidth, "error")) / 2 * (1 if self.left else -1)
        self.growth, self.slip = get(TyreGrowth, "k"), get(WheelSlip, "k")
        self.out, self.out_at = get(WheelEccentricity, "amplitude"), get(WheelEccentricity, "phase")
        self.camber, self.grade = get(WheelCamber, "angle"), get(RoadGrade, "angle")
        self.arm = np.array([get(LeverArm, axis) for axis in "xyz"])
        solution = solve_ivp(
            self.rates, (0, END), [0, 0, 0, start], "DOP853", dense_output=True, rtol=1e-12, atol=1e-13
        )
        self.at = solution.sol

    def rates(self, t, state):
        _, _, heading, angle = state
        v, r = speed(t), yaw(t)
        rolled = v - r * self.half
        rolled *= 1 + self.slip * (pull(t) - yaw_slope(t) * self.half)

        def too_far(spin):
            radius = self.radius * (1 + self.growth * spin**2) * (1 + self.out * np.cos(angle - self.out_at))
            return spin * radius - rolled

        return [v * np.cos(heading), v * np.sin(heading), r, brentq(too_far, -60, 60, xtol=1e-13)]

    def pose(self, t):
        """Return position of the sensing point (3,) and attitudes of node and body (3, 3) in the world."""
        x, y, heading, angle = self.at(t)
        c, s = np.cos(heading), np.sin(heading)
        body = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        lean = self.camber if self.left else -self.camber
        tilt = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
        axle, up = tilt @ [0, 1.0, 0], tilt @ [0, 0, 1.0]
        # Rodrigues' formula about the axle, which points left: forward rolling moves the top of the wheel
        # forward.
        k = np.array([[0, -axle[2], axle[1]], [axle[2], 0, -axle[0]], [-axle[1], axle[0], 0]])
        spoke = (np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k) @ up
        z = axle if self.facing == "left" else -axle
        node = np.column_stack([spoke, np.cross(z, spoke), z])
        hub = np.array([0.0, self.half, 0.0]) + self.radius * up
        return np.array([x, y, 0]) + body @ (hub + node @ self.arm), body @ node, body

    def reads(self, t, h=2e-3):
        """Return angular rate (3,) and specific force (3,) in node axes, by fourth-order differences."""
        p, attitude, body = zip(*(self.pose(t + n * h) for n in (-2, -1, 0, 1, 2)), strict=True)
        acceleration = (-p[0] + 16 * p[1] - 30 * p[2] + 16 * p[3] - p[4]) / (12 * h * h)
        turning = (attitude[0] - 8 * attitude[1] + 8 * attitude[3] - attitude[4]) / (12 * h)
        skew = attitude[2].T @ turning
        vertical = body[2] @ [np.sin(self.grade), 0, np.cos(self.grade)]
        rate = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
        return rate, attitude[2].T @ (acceleration + G * vertical)


def model_reads(side, facing, effects, start, times, inputs=None):
    t = np.union1d(np.arange(0.0, END, 0.005), times)
    forward = NodeModel(inputs or driven(), t, NodeMount(side, facing), R, B)
    reading = forward.mean_reading(effects, NodeInitialState(start))
    at = np.searchsorted(t, times)
    return reading.gyro[:, at].T, reading.accel[:, at].T, reading.rolling.angle[at]


ALONE = [
    [],
    [TrackWidth(0.05)],
    [RoadGrade(0.08)],
    [WheelRadius(-0.03)],
    [TyreGrowth(8e-4)],
    [WheelSlip(0.06)],
    [WheelEccentricity(0.04, 0.7)],
    [WheelCamber(0.09)],
    [LeverArm(0.012, -0.02, 0.03)],
]
TOGETHER = [effect for effects in ALONE for effect in effects]


@pytest.mark.parametrize("facing", SIDES)
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(
    "effects", [*ALONE, TOGETHER], ids=[*("+".join(e.name for e in a) or "none" for a in ALONE), "all"]
)
def test_rate_and_force_are_the_derivatives_of_a_rigid_wheel_in_space(effects, side, facing):
    times = np.array([0.4, 1.7, 3.3, 4.6])
    wheel = RigidWheel(side, facing, effects, start=0.4)
    rate, force, angle = model_reads(side, facing, effects, 0.4, times)
    for i, t in enumerate(times):
        assert angle[i] == pytest.approx(wheel.at(t)[3], abs=1e-7)
        true_rate, true_force = wheel.reads(t)
        np.testing.assert_allclose(rate[i], true_rate, rtol=0, atol=2e-6)
        np.testing.assert_allclose(force[i], true_force, rtol=0, atol=2e-5)


def steady(v=0.0, r=0.0, angle=0.0, effects=(), side="left", facing="left", radius=0.3, track=1.0):
    """Return (gyro (3,), accel (3,)) of a wheel in steady motion, at angle `angle`."""
    inputs = MotionInputs(constant_spline(v, 0.0, 1.0), constant_spline(r, 0.0, 1.0))
    forward = NodeModel(inputs, np.zeros(1), NodeMount(side, facing), radius, track)
    reading = forward.mean_reading(effects, NodeInitialState(angle))
    return reading.gyro[:, 0], reading.accel[:, 0]


@pytest.mark.parametrize(("angle", "force"), [(0.0, [G, 0, 0]), (np.pi / 2, [0, -G, 0]), (np.pi, [-G, 0, 0])])
def test_at_standstill_gravity_rotates_with_the_wheel_angle(angle, force):
    """Calculated by hand: x of the node points up at angle 0, and forward after a quarter turn forward."""
    gyro, accel = steady(angle=angle)
    np.testing.assert_allclose(accel, force, atol=1e-12)
    assert not gyro.any()


def test_constant_speed_adds_the_centripetal_force_of_the_lever_arm():
    """Calculated by hand: omega = v / R = 5 rad/s, arm 0.1 m on x: 2.5 m/s² towards the axle, along -x."""
    gyro, accel = steady(v=1.5, effects=[LeverArm(x=0.1)])
    np.testing.assert_allclose(gyro, [0, 0, 5.0])
    np.testing.assert_allclose(accel, [G - 2.5, 0, 0], atol=1e-12)


def test_turning_on_the_spot_rolls_the_left_wheel_back_and_the_right_one_forward():
    """Calculated by hand: r = 2 rad/s, track 1 m, R 0.25 m: wheel rates -4 and +4 rad/s."""
    for side, rate in (("left", -4.0), ("right", 4.0)):
        gyro, _ = steady(r=2.0, side=side, radius=0.25)
        np.testing.assert_allclose(gyro, [2.0, 0.0, rate])


@pytest.mark.parametrize(
    ("side", "facing", "spin_sign", "camber_sign"),
    [("left", "left", 1, 1), ("right", "left", 1, -1), ("left", "right", -1, -1), ("right", "right", -1, 1)],
)
def test_signs_of_the_spin_axis(side, facing, spin_sign, camber_sign):
    """The sign table: gz = theta' + r sin(camber) on a left wheel facing left, and so on."""
    gyro, _ = steady(v=3.0, r=0.7, effects=[WheelCamber(0.1)], side=side, facing=facing)
    spin = (3.0 - 0.7 * (0.5 if side == "left" else -0.5)) / 0.3
    assert gyro[2] == pytest.approx(spin_sign * spin + camber_sign * 0.7 * np.sin(0.1))


def test_across_the_axle_the_yaw_rate_rotates_with_the_wheel():
    """gx = r cos(camber) cos(theta), gy = -r cos(camber) sin(theta) on a node facing left."""
    gyro, _ = steady(v=1.0, r=0.7, angle=0.6, effects=[WheelCamber(0.1)])
    np.testing.assert_allclose(gyro[:2], 0.7 * np.cos(0.1) * np.array([np.cos(0.6), -np.sin(0.6)]))


def test_on_a_grade_gravity_has_a_forward_component():
    """Calculated by hand for 30 degrees: half of g along x of the body.

    A node at wheel angle 0 has x up and y forward.
    """
    climb = [RoadGrade(np.deg2rad(30))]
    np.testing.assert_allclose(steady(effects=climb)[1], [G * np.sqrt(3) / 2, G / 2, 0], atol=1e-12)
    still = MotionInputs(constant_spline(0.0, 0.0, 1.0), constant_spline(0.0, 0.0, 1.0))
    body = NodeModel(still, np.zeros(1), NodeMount(), R, B).mean_reading(climb, NodeInitialState())
    np.testing.assert_allclose(body.accel[:, 0], [G / 2, 0, G * np.sqrt(3) / 2])


def test_an_eccentric_wheel_turns_unevenly_within_a_turn_and_evenly_over_turns():
    """Calculated by hand: 1 rad/s over 1 + A cos(theta - p): slowest where the radius is largest."""
    inputs = MotionInputs(constant_spline(0.3, 0.0, 20.0), constant_spline(0.0, 0.0, 20.0))
    t = np.linspace(0.0, 4 * np.pi, 801)
    forward = NodeModel(inputs, t, NodeMount("left", "left"), 0.3, 1.0)
    reading = forward.mean_reading([WheelEccentricity(0.1, 1.0)], NodeInitialState(1.0))
    assert reading.gyro[2, 0] == pytest.approx(1 / 1.1)
    assert reading.gyro[2].max() == pytest.approx(1 / 0.9, rel=1e-4)
    assert reading.rolling.angle[-1] == pytest.approx(1.0 + 4 * np.pi, abs=1e-9)


def test_a_node_on_the_body_measures_the_motion_of_the_body():
    """Calculated by hand: 2 m/s on a circle of 4 m: 1 m/s² left; an arm of 0.4 m adds 0.1."""
    inputs = MotionInputs(constant_spline(2.0, 0.0, 1.0), constant_spline(0.5, 0.0, 1.0))
    forward = NodeModel(inputs, np.zeros(1), NodeMount(), R, B)
    plain, off = (
        forward.mean_reading([], NodeInitialState()),
        forward.mean_reading([LeverArm(x=0.4)], NodeInitialState()),
    )
    np.testing.assert_allclose(plain.gyro[:, 0], [0, 0, 0.5])
    np.testing.assert_allclose(plain.accel[:, 0], [0, 1.0, G])
    np.testing.assert_allclose(off.accel[:, 0], [-0.1, 1.0, G], atol=1e-12)
    turned = forward.mean_reading([], NodeInitialState(attitude=(0, 0, np.pi / 2)))
    np.testing.assert_allclose(turned.accel[:, 0], [1.0, 0, G], atol=1e-12)


def test_the_earth_turns_under_a_bench_about_its_own_axis():
    """Calculated by hand: Earth rate lies north and up, and body x is at azimuth A - heading from north."""
    latitude, azimuth = 0.8, 0.6
    t = np.linspace(0.0, 4.0, 401)
    inputs = MotionInputs(
        constant_spline(0.0, 0.0, 4.0),
        fit_interpolating_spline(t, yaw(t)),
        earth=EarthRotation(latitude, azimuth),
    )
    forward = NodeModel(inputs, t, NodeMount(), R, B)
    still = replace(inputs, earth=None)
    plain = NodeModel(still, t, NodeMount(), R, B).mean_reading([], NodeInitialState()).gyro
    world = 7.2921159e-5 * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    course = np.pi / 2 - azimuth + inputs.yaw_rate.integral(t)
    ahead = np.stack([np.cos(course), np.sin(course), 0 * t])
    left = np.stack([-np.sin(course), np.cos(course), 0 * t])
    expected = np.stack([world @ ahead, world @ left, 0 * t + world[2]])
    np.testing.assert_allclose(
        forward.mean_reading([], NodeInitialState()).gyro - plain, expected, rtol=0, atol=1e-15
    )
    rate, slope = inputs.earth.rate_and_derivative(inputs.yaw_rate.integral(t), inputs.yaw_rate(t))
    np.testing.assert_allclose(slope[:, 1:-1], np.gradient(rate, t, axis=1)[:, 1:-1], rtol=0, atol=1e-8)


LEVEL = [TrackWidth(0.03), WheelRadius(0.01), TyreGrowth(1e-4), WheelSlip(0.02), WheelEccentricity(0.02, 0.5)]


@settings(max_examples=40)
@given(
    v=st.floats(-4, 4),
    a=st.floats(-2, 2),
    r=st.floats(-2, 2),
    start=st.floats(-4, 4),
    camber=st.floats(-0.3, 0.3),
)
def test_a_mirrored_drive_on_the_other_wheel_reads_mirrored(v, a, r, start, camber):
    """Mirroring left and right: forces mirror like vectors, rates like axial vectors."""
    t = np.linspace(0.0, 1.0, 101)
    arm = (0.01, 0.02, 0.03)
    readings = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        inputs = MotionInputs(
            fit_interpolating_spline(t, v + a * t + 0.2 * t**2),
            fit_interpolating_spline(t, sign * (r - 0.3 * t)),
        )
        effects = [*LEVEL, WheelCamber(camber), LeverArm(arm[0], arm[1], sign * arm[2])]
        readings.append(
            NodeModel(inputs, t, NodeMount(side, "left"), R, B).mean_reading(effects, NodeInitialState(start))
        )
    one, two = readings
    np.testing.assert_allclose(two.accel, one.accel * [[1], [1], [-1]], atol=1e-8)
    np.testing.assert_allclose(two.gyro, one.gyro * [[-1], [-1], [1]], atol=1e-8)


@settings(max_examples=25)
@given(start=st.floats(-4, 4), later=st.floats(0.0, 1e4), side=st.sampled_from(SIDES))
def test_the_same_drive_at_another_time_reads_the_same(start, later, side):
    grid = np.linspace(0.0, 2.0, 201)
    readings = []
    for start_time in (0.0, later):
        inputs = MotionInputs(
            fit_interpolating_spline(grid + start_time, speed(grid)),
            fit_interpolating_spline(grid + start_time, yaw(grid)),
        )
        forward = NodeModel(inputs, grid + start_time, NodeMount(side, "right"), R, B)
        readings.append(forward.mean_reading(TOGETHER, NodeInitialState(start)))
    np.testing.assert_allclose(readings[1].gyro, readings[0].gyro, atol=1e-6)
    np.testing.assert_allclose(readings[1].accel, readings[0].accel, atol=1e-5)
