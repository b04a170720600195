"""The forward model as the motion of a chip: readings at chip times equal those of the model."""

import pickle

import numpy as np
import pytest

from hubodo.effects import EFFECTS, Noise
from hubodo.effects.gyro import GyroBias, GyroLag, GyroRateRandomWalk, GyroSaturation
from hubodo.effects.mounting import LeverArm, NodeMisalignment
from hubodo.effects.timing import Outliers
from hubodo.effects.warmup import GyroWarmup
from hubodo.effects.wheel import TyreGrowth, WheelCamber, WheelEccentricity, WheelSlip
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.motion import Motion
from hubodo.emulator.node_motion import NodeMotion, SensorDisturbance
from hubodo.model.drive import Leg, scripted_drive
from hubodo.model.forward import NodeInitialState, NodeModel
from hubodo.model.inputs import MotionInputs
from hubodo.smoothing_spline import constant_spline
from hubodo.vehicle import NodeMount

LEGS = scripted_drive([Leg(1.0, 0.0), Leg(3.0, 1.5, 0.7), Leg(2.0, 2.5, -0.5), Leg(1.0, 0.0)])
EFFECTS_HIDDEN = (
    TyreGrowth(2e-4),
    WheelSlip(0.05),
    WheelEccentricity(0.03, 0.4),
    WheelCamber(0.1),
    LeverArm(0.01, 0.02, 0.03),
    NodeMisalignment(0.02, 0.01, 0.0),
    GyroLag(0.01),
    GyroBias(0.01, 0.02, 0.03),
    GyroWarmup(0.1, 0.2, 0.3, 4.0),
)


def motion(effects=EFFECTS_HIDDEN, **some):
    return NodeMotion(
        LEGS, NodeMount("left", "left"), 0.3, 0.9, effects, NodeInitialState(0.5), delay=1.5, **some
    )


def test_the_chip_measures_the_readings_of_the_forward_model():
    t = np.sort(np.random.default_rng(0).uniform(0.0, 8.5, 300))
    fine = np.union1d(np.arange(-1.5, 7.0, 0.001), t - 1.5)
    whole = NodeModel(LEGS, fine, NodeMount("left", "left"), 0.3, 0.9, power_on=-1.5)
    reading = whole.mean_reading(EFFECTS_HIDDEN, NodeInitialState(0.5))
    at = np.searchsorted(fine, t - 1.5)
    node_motion = motion()
    np.testing.assert_allclose(node_motion.angular_rate(t), reading.gyro[:, at].T, rtol=0, atol=1e-6)
    np.testing.assert_allclose(node_motion.specific_force(t), reading.accel[:, at].T, rtol=0, atol=1e-5)
    assert node_motion.duration == pytest.approx(8.5)


def test_it_is_a_function_of_time_in_any_order_and_in_another_process():
    node_motion = motion((*EFFECTS_HIDDEN, GyroRateRandomWalk(0.01)), seed=3)
    assert isinstance(node_motion, Motion)
    t = np.random.default_rng(1).uniform(0.0, 8.0, 50)
    once = node_motion.angular_rate(t)
    np.testing.assert_array_equal(node_motion.angular_rate(t[::-1])[::-1], once)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(node_motion)).angular_rate(t), once)
    assert not np.array_equal(motion((GyroRateRandomWalk(0.01),), seed=4).angular_rate(t), once)


def test_a_random_walk_in_the_chip_has_the_spread_of_the_model():
    ends = []
    for seed in range(200):
        still = MotionInputs(constant_spline(0.0, 0.0, 1.0), constant_spline(0.0, 0.0, 1.0))
        walk = NodeMotion(still, NodeMount(), 0.3, 0.9, (GyroRateRandomWalk(0.02),), seed=seed)
        ends.append(walk.angular_rate(np.array([1.0]))[0])
    assert np.std(ends) == pytest.approx(0.02, rel=0.1)


def test_the_magnetic_field_rotates_with_the_wheel_at_constant_strength():
    t = np.linspace(0.0, 8.0, 100)
    field = motion().magnetic_field(t)
    np.testing.assert_allclose(np.linalg.norm(field, axis=1), np.hypot(20e-6, 44e-6), rtol=1e-6)
    # At rest at wheel angle 0 and facing left: x up, y forward (north), z left.
    still = NodeMotion(LEGS, NodeMount("left", "left"), 0.3, 0.9)
    np.testing.assert_allclose(still.magnetic_field(np.zeros(1))[0], [-44e-6, 20e-6, 0.0], atol=1e-12)


def test_noise_limits_and_outliers_follow_the_motion():
    scatter = SensorDisturbance(Noise(0.01, 0.1), (Outliers(0.05, 30.0), GyroSaturation(1.5)))
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 50.0, 0.002)
    gyro, accel = scatter(t, np.full((len(t), 3), 1.0), np.zeros((len(t), 3)), rng)
    assert gyro.shape == accel.shape == (len(t), 3)
    assert gyro.max() == 1.5
    assert np.median(np.abs(accel)) == pytest.approx(0.6745 * 0.1, rel=0.1)
    assert np.mean(np.abs(accel) > 0.5) == pytest.approx(0.05 * 0.868, rel=0.1)
    Specimen(disturbance=scatter)


def test_effects_with_default_parameters_change_nothing():
    t = np.linspace(0.0, 8.0, 100)
    nothing = tuple(kind() for kind in EFFECTS)
    np.testing.assert_array_equal(motion(()).angular_rate(t), motion(nothing).angular_rate(t))
