"""The forward model as the motion of a chip: what the chip feels at its own times is what the model says."""

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
from hubodo.model.drive import Leg, integrate_path, loop_drive, random_drive, scripted_drive
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


def test_the_chip_feels_what_the_forward_model_reads():
    t = np.sort(np.random.default_rng(0).uniform(0.0, 8.5, 300))
    fine = np.union1d(np.arange(-1.5, 7.0, 0.001), t - 1.5)
    whole = NodeModel(LEGS, fine, NodeMount("left", "left"), 0.3, 0.9, power_on=-1.5)
    reading = whole.mean_reading(EFFECTS_HIDDEN, NodeInitialState(0.5))
    at = np.searchsorted(fine, t - 1.5)
    felt = motion()
    np.testing.assert_allclose(felt.angular_rate(t), reading.gyro[:, at].T, rtol=0, atol=1e-6)
    np.testing.assert_allclose(felt.specific_force(t), reading.accel[:, at].T, rtol=0, atol=1e-5)
    assert felt.duration == pytest.approx(8.5)


def test_it_is_a_function_of_time_in_any_order_and_in_another_process():
    felt = motion((*EFFECTS_HIDDEN, GyroRateRandomWalk(0.01)), seed=3)
    assert isinstance(felt, Motion)
    t = np.random.default_rng(1).uniform(0.0, 8.0, 50)
    once = felt.angular_rate(t)
    np.testing.assert_array_equal(felt.angular_rate(t[::-1])[::-1], once)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(felt)).angular_rate(t), once)
    assert not np.array_equal(motion((GyroRateRandomWalk(0.01),), seed=4).angular_rate(t), once)


def test_a_random_walk_in_the_chip_has_the_spread_of_the_model():
    ends = []
    for seed in range(200):
        still = MotionInputs(constant_spline(0.0, 0.0, 1.0), constant_spline(0.0, 0.0, 1.0))
        walk = NodeMotion(still, NodeMount(), 0.3, 0.9, (GyroRateRandomWalk(0.02),), seed=seed)
        ends.append(walk.angular_rate(np.array([1.0]))[0])
    assert np.std(ends) == pytest.approx(0.02, rel=0.1)


def test_the_field_turns_with_the_wheel_and_keeps_its_strength():
    t = np.linspace(0.0, 8.0, 100)
    field = motion().magnetic_field(t)
    np.testing.assert_allclose(np.linalg.norm(field, axis=1), np.hypot(20e-6, 44e-6), rtol=1e-6)
    # At rest at wheel angle 0 and facing left: x up, y forward (north), z left.
    still = NodeMotion(LEGS, NodeMount("left", "left"), 0.3, 0.9)
    np.testing.assert_allclose(still.magnetic_field(np.zeros(1))[0], [-44e-6, 20e-6, 0.0], atol=1e-12)


def test_noise_limits_and_wild_samples_come_after_the_motion():
    scatter = SensorDisturbance(Noise(0.01, 0.1), (Outliers(0.05, 30.0), GyroSaturation(1.5)))
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 50.0, 0.002)
    gyro, accel = scatter(t, np.full((len(t), 3), 1.0), np.zeros((len(t), 3)), rng)
    assert gyro.shape == accel.shape == (len(t), 3)
    assert gyro.max() == 1.5
    assert np.median(np.abs(accel)) == pytest.approx(0.6745 * 0.1, rel=0.1)
    assert np.mean(np.abs(accel) > 0.5) == pytest.approx(0.05 * 0.868, rel=0.1)
    Specimen(disturbance=scatter)


def test_a_chip_without_effects_and_one_with_effects_of_nothing_feel_the_same():
    t = np.linspace(0.0, 8.0, 100)
    nothing = tuple(kind() for kind in EFFECTS)
    np.testing.assert_array_equal(motion(()).angular_rate(t), motion(nothing).angular_rate(t))


def test_the_path_of_a_constant_turn_is_a_circle():
    inputs = MotionInputs(constant_spline(2.0, 0.0, 10.0), constant_spline(0.5, 0.0, 10.0))
    t, x, y, heading = integrate_path(inputs)
    np.testing.assert_allclose(heading, 0.5 * t, atol=1e-12)
    np.testing.assert_allclose(x, 4.0 * np.sin(0.5 * t), atol=1e-9)
    np.testing.assert_allclose(y, 4.0 * (1 - np.cos(0.5 * t)), atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_drives_begin_and_end_at_rest_and_a_random_one_turns_both_ways(seed):
    rng = np.random.default_rng(seed)
    for drive, length in ((loop_drive(rng, driving_time=20.0), 32.0), (random_drive(rng, 90.0), 90.0)):
        t = np.arange(0.0, length, 0.01)
        assert drive.speed.end == pytest.approx(length, abs=0.02)
        for value in (drive.speed(t), drive.yaw_rate(t)):
            assert np.abs(value[[0, 1, -2, -1]]).max() < 1e-6, f"seed {seed}"
    assert drive.yaw_rate(t).min() < -0.2 < 0.2 < drive.yaw_rate(t).max(), f"seed {seed}"
    assert 0.8 < drive.speed(t).max() <= 2.5, f"seed {seed}"


def test_a_drive_of_nothing_is_refused():
    for legs in ([], [Leg(0.0, 1.0)]):
        with pytest.raises(ValueError, match="positive duration"):
            scripted_drive(legs)
