"""What the class of an effect says of itself: signs by facing, beliefs of the odometry."""

import math

import numpy as np
import pytest

from hubodo.effects import EFFECTS
from hubodo.model.forward import NodeForward, Start
from hubodo.model.inputs import Inputs
from hubodo.smooth import through
from hubodo.vehicle import NodeMount

NEGATED = np.array([[1.0], [-1.0], [-1.0]])
"""What facing right does to the axes of a node, and so to all that is stated in them."""


def reads(effects, facing, side="left", yaw=1.0):
    """(gyro, accel), (3, N) each, of one node in the mean."""
    t = np.arange(0.0, 8.005, 0.01)
    inputs = Inputs(
        through(t, 1.5 + np.sin(0.7 * t)),
        through(t, yaw * 0.6 * np.cos(0.9 * t)),
        np.array([0.0, 8.0]),
        np.array([20.0, 45.0]),
    )
    node = NodeForward(inputs, t[100:-100], NodeMount(side, facing), 0.31, 0.92)
    reading = node.mean(list(effects), Start(0.3))
    return reading.gyro, reading.accel


def sized(kind):
    """The effect at numbers that differ from each other, large enough to be seen in every channel."""
    return kind(
        **{name: 3.0 * kind.scale(name) * (1.0 + 0.3 * k) for k, name in enumerate(kind.parameters())}
    )


def facing_right(effect):
    kind = type(effect)
    return kind(**{name: kind.sign(name, "right") * value for name, value in effect.values().items()})


@pytest.mark.parametrize("kind", EFFECTS, ids=lambda kind: kind.name)
def test_a_node_facing_right_with_turned_signs_reads_the_same_with_y_and_z_negated(kind):
    effect = sized(kind)
    left, right = reads([effect], "left"), reads([facing_right(effect)], "right")
    for one, other in zip(left, right, strict=True):
        np.testing.assert_allclose(NEGATED * other, one, rtol=0, atol=1e-9)
    assert all(kind.sign(name, "left") == 1.0 for name in kind.parameters())


@pytest.mark.parametrize("kind", EFFECTS, ids=lambda kind: kind.name)
def test_each_sign_is_needed(kind):
    """A parameter with the other sign than it is said to have reads something else."""
    plain = facing_right(sized(kind))
    before = np.concatenate(reads([plain], "right"))
    for name, value in plain.values().items():
        if kind.shows == "scatter" or name in ("time_constant", "amplitude", "phase"):
            continue
        other = kind(**(plain.values() | {name: -value}))
        assert np.abs(np.concatenate(reads([other], "right")) - before).max() > 1e-4, name


@pytest.mark.parametrize("kind", [k for k in EFFECTS if k.level != "node"], ids=lambda kind: kind.name)
def test_what_belongs_to_wheel_or_vehicle_is_the_same_in_the_mirror(kind):
    """The mirror image of the vehicle turns the other way, its left wheel is the right one and its node faces
    the other way; forces mirror as vectors, rates as axial vectors."""
    effect = [sized(kind)]
    gyro, accel = reads(effect, "left")
    mirrored_gyro, mirrored_accel = reads(effect, "right", side="right", yaw=-1.0)
    np.testing.assert_allclose(mirrored_accel, np.array([[1.0], [-1.0], [1.0]]) * accel, rtol=0, atol=1e-9)
    np.testing.assert_allclose(mirrored_gyro, np.array([[-1.0], [1.0], [-1.0]]) * gyro, rtol=0, atol=1e-9)


def test_what_the_odometry_believes_is_positive_and_a_process_keeps_its_size():
    found = {
        (kind.name, name): kind.estimate(name)
        for kind in EFFECTS
        for name in kind.parameters()
        if kind.estimate(name) is not None
    }
    assert {f"{effect}.{name}" for effect, name in found} == {
        *(f"gyro_scale_factor.{axis}" for axis in "xyz"),
        *(f"gyro_bias.{axis}" for axis in "xyz"),
        *(f"accel_bias.{axis}" for axis in "xyz"),
        *("gyro_g_sensitivity.xx", "gyro_g_sensitivity.yy"),
        *("accel_nonorthogonality.zx", "accel_nonorthogonality.zy"),
        *("node_misalignment.x", "node_misalignment.y", "lever_arm.x", "lever_arm.y"),
        *("wheel_camber.angle", "wheel_radius.error", "track_width.error", "road_grade.angle"),
        "time_offset.delay",
    }
    for place, one in found.items():
        assert one.prior > 0.0 and one.walk >= 0.0 and one.origin, place
        if math.isfinite(one.forgets):
            # Gauss-Markov: what it forgets in a second is what the walk brings.
            assert one.walk**2 == pytest.approx(2.0 / one.forgets * one.prior**2), place


def test_g_sensitivity_has_nine_parameters_of_which_a_drive_moves_three():
    kind = next(kind for kind in EFFECTS if kind.name == "gyro_g_sensitivity")
    bench = kind(xy=2e-3, yz=1e-3)
    assert kind.fitted() == ("x", "y", "z") and len(bench.coordinates()) == 3
    moved = bench.at(np.array([1e-4, 2e-4, 3e-4]))
    assert (moved.x, moved.y, moved.z, moved.xy, moved.yz) == (1e-4, 2e-4, 3e-4, 2e-3, 1e-3)
    plain_gyro, plain_force = reads([], "left")
    added = reads([bench], "left")[0] - plain_gyro
    np.testing.assert_allclose(added[0], 2e-3 * plain_force[1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(added[1], 1e-3 * plain_force[2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(added[2], 0.0, rtol=0, atol=1e-15)
