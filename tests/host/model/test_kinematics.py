"""The forward kinematics against a rigid wheel rolled through space and differentiated numerically."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import cumulative_trapezoid, trapezoid

from hubodo.model.drive import Drive, Leg, scripted
from hubodo.model.frames import node_from_body
from hubodo.model.kinematics import BodyMotion, WheelMount, body_node_motion, wheel_node_motion

G = 9.80665
SIDES = ["left", "right"]


def rolled_wheel(drive: Drive, mount: WheelMount, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Position of the sensing point (3,) and attitude (3, 3) of the node in the world, at one instant.

    Written from geometry alone: the body on a plane, the hub over the contact, the node turned about the axle
    by Rodrigues' formula. Shares nothing with the code under test but the drive's speed and yaw rate.
    """
    fine = np.linspace(0.0, t, 20001)
    motion = drive.body(fine)
    heading = cumulative_trapezoid(motion.yaw_rate, fine, initial=0.0)
    x = trapezoid(motion.speed * np.cos(heading), fine)
    y = trapezoid(motion.speed * np.sin(heading), fine)
    left = mount.side == "left"
    half = mount.track_width / 2 * (1 if left else -1)
    angle = trapezoid(motion.speed - motion.yaw_rate * half, fine) / mount.radius
    c, s = np.cos(heading[-1]), np.sin(heading[-1])
    body = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    lean = mount.camber if left else -mount.camber
    tilt = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])
    axle, up, forward = tilt @ [0, 1.0, 0], tilt @ [0, 0, 1.0], np.array([1.0, 0, 0])
    k = np.array([[0, -axle[2], axle[1]], [axle[2], 0, -axle[0]], [-axle[1], axle[0], 0]])
    turn = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    z = axle if mount.facing == "left" else -axle
    node = np.column_stack([turn @ up, np.cross(z, turn @ up), z])
    assert np.allclose(turn @ up, np.cos(angle) * up + np.sin(angle) * forward)
    contact = np.array([0.0, half, 0.0])
    hub = contact + mount.radius * up
    return np.array([x, y, 0]) + body @ (hub + node @ np.asarray(mount.lever_arm)), body @ node


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("facing", SIDES)
@pytest.mark.parametrize("camber", [0.0, 0.09])
def test_rate_and_force_are_the_derivatives_of_a_rigid_wheel_in_space(side, facing, camber):
    drive = scripted([Leg(2.0, 0.4, 0.3), Leg(2.0, 1.6, -0.8), Leg(2.0, 0.7, 0.6)])
    mount = WheelMount(side, facing, 0.31, 0.92, camber, (0.012, -0.02, 0.03))
    h = 2e-3
    for t in (1.7, 2.2, 3.9, 4.3):
        at = [rolled_wheel(drive, mount, t + n * h) for n in (-2, -1, 0, 1, 2)]
        p = [item[0] for item in at]
        attitude = at[2][1]
        acceleration = (-p[0] + 16 * p[1] - 30 * p[2] + 16 * p[3] - p[4]) / (12 * h * h)
        turning = (at[0][1] - 8 * at[1][1] + 8 * at[3][1] - at[4][1]) / (12 * h)
        skew = attitude.T @ turning
        rate = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
        force = attitude.T @ (acceleration + np.array([0, 0, G]))

        theta = drive.wheel_angle(np.array([t]), mount)
        ours = wheel_node_motion(drive.body(np.array([t])), mount, theta)
        np.testing.assert_allclose(ours.angular_rate[0], rate, atol=2e-5)
        np.testing.assert_allclose(ours.specific_force[0], force, atol=2e-3)


def still(n: int = 1) -> BodyMotion:
    return BodyMotion(*(np.zeros(n) for _ in range(4)))


def test_at_rest_gravity_turns_with_the_wheel_angle():
    """By hand: at angle 0 the node's x axis points up; after a quarter turn forwards it points forward."""
    mount = WheelMount("left", "left", 0.3, 1.0)
    theta = np.array([0.0, np.pi / 2, np.pi])
    motion = wheel_node_motion(still(3), mount, theta)
    np.testing.assert_allclose(motion.specific_force, [[G, 0, 0], [0, -G, 0], [-G, 0, 0]], atol=1e-12)
    assert not motion.angular_rate.any()


def test_constant_speed_adds_the_centripetal_force_of_the_lever_arm():
    """By hand: omega = v / R = 5 rad/s, arm 0.1 m on x: 2.5 m/s² towards the axle, along -x."""
    mount = WheelMount("left", "left", 0.3, 1.0, lever_arm=(0.1, 0.0, 0.0))
    body = BodyMotion(np.array([1.5]), np.zeros(1), np.zeros(1), np.zeros(1))
    motion = wheel_node_motion(body, mount, np.zeros(1))
    np.testing.assert_allclose(motion.angular_rate, [[0, 0, 5.0]])
    np.testing.assert_allclose(motion.specific_force, [[G - 2.5, 0, 0]], atol=1e-12)


def test_turning_on_the_spot_rolls_the_left_wheel_back_and_the_right_one_forward():
    """By hand: r = 2 rad/s, track 1 m, R 0.25 m: wheel rates -4 and +4 rad/s."""
    body = BodyMotion(np.zeros(1), np.zeros(1), np.array([2.0]), np.zeros(1))
    for side, rate in (("left", -4.0), ("right", 4.0)):
        motion = wheel_node_motion(body, WheelMount(side, "left", 0.25, 1.0), np.zeros(1))
        np.testing.assert_allclose(motion.angular_rate, [[2.0, 0.0, rate]])


@pytest.mark.parametrize(
    ("side", "facing", "spin_sign", "camber_sign"),
    [("left", "left", 1, 1), ("right", "left", 1, -1), ("left", "right", -1, -1), ("right", "right", -1, 1)],
)
def test_signs_of_the_spin_axis(side, facing, spin_sign, camber_sign):
    """The sign table of the model: gz = theta' + r sin(camber) on a left wheel facing left, and so on."""
    camber, yaw = 0.1, 0.7
    mount = WheelMount(side, facing, 0.3, 1.0, camber)
    body = BodyMotion(np.array([3.0]), np.zeros(1), np.array([yaw]), np.zeros(1))
    spin = (3.0 - yaw * mount.contact_y) / 0.3
    gz = wheel_node_motion(body, mount, np.zeros(1)).angular_rate[0, 2]
    assert gz == pytest.approx(spin_sign * spin + camber_sign * yaw * np.sin(camber))


@given(
    v=st.floats(-5, 5),
    a=st.floats(-3, 3),
    r=st.floats(-2, 2),
    b=st.floats(-2, 2),
    theta=st.floats(-10, 10),
    camber=st.floats(-0.3, 0.3),
)
def test_a_mirrored_drive_on_the_other_wheel_reads_mirrored(v, a, r, b, theta, camber):
    """Mirroring left and right: forces mirror like vectors, rates like axial vectors."""
    arm = (0.01, 0.02, 0.03)
    left = WheelMount("left", "left", 0.3, 0.9, camber, arm)
    right = WheelMount("right", "left", 0.3, 0.9, camber, (arm[0], arm[1], -arm[2]))
    one = wheel_node_motion(BodyMotion(*(np.array([q]) for q in (v, a, r, b))), left, np.array([theta]))
    two = wheel_node_motion(BodyMotion(*(np.array([q]) for q in (v, a, -r, -b))), right, np.array([theta]))
    np.testing.assert_allclose(two.specific_force, one.specific_force * [1, 1, -1], atol=1e-9)
    np.testing.assert_allclose(two.angular_rate, one.angular_rate * [-1, -1, 1], atol=1e-9)


@given(
    theta=st.floats(-100, 100),
    camber=st.floats(-0.5, 0.5),
    side=st.sampled_from(SIDES),
    facing=st.sampled_from(SIDES),
)
def test_node_axes_are_right_handed_and_orthonormal(theta, camber, side, facing):
    rotation = node_from_body(np.array([theta]), side, facing, camber)[0]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_a_climb_tips_gravity_forward_in_the_body():
    motion = body_node_motion(still(), grade=np.deg2rad(30))
    np.testing.assert_allclose(motion.specific_force, [[G / 2, 0, G * np.sqrt(3) / 2]])
    wheel = wheel_node_motion(
        still(), WheelMount("left", "left", 0.3, 1.0), np.zeros(1), grade=np.deg2rad(30)
    )
    np.testing.assert_allclose(wheel.specific_force, [[G * np.sqrt(3) / 2, G / 2, 0]], atol=1e-12)


def test_the_path_of_a_constant_turn_is_a_circle():
    drive = Drive(np.linspace(0, 10, 101), np.full(101, 2.0), np.full(101, 0.5))
    t, x, y, heading = drive.path()
    np.testing.assert_allclose(heading, 0.5 * t, atol=1e-12)
    np.testing.assert_allclose(x, 4.0 * np.sin(0.5 * t), atol=1e-9)
    np.testing.assert_allclose(y, 4.0 * (1 - np.cos(0.5 * t)), atol=1e-9)
