"""Nodes with an accelerometer or a gyro alone, and with some axes of one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hubodo
from generators.poses import EARTH, GRAVITY, Errors, carry
from hubodo.errors import CalibrationError, InputError

ACCEL = Errors((0.2, -0.3, 0.1), (0.01, -0.02, 0.005))
GYRO = Errors((0.01, -0.02, 0.015), (0.01, -0.02, 0.005))


def assert_within_sigma(triad, sigma, errors):
    pulls = (
        np.append(triad.bias - errors.b, np.diag(triad.matrix) - 1 - errors.e) / sigma[[0, 1, 2, 3, 7, 11]]
    )
    assert np.abs(pulls).max() < 4.0 and np.abs(pulls).max() > 1e-3


def test_an_accelerometer_alone_is_calibrated_as_beside_a_gyro():
    data = carry(np.random.default_rng(3), Errors(), ACCEL, poses=16, dt=0.02, standstill_s=3.0)
    log = hubodo.from_arrays(accel=data.accel, t=data.t)
    result = log.calibrate_imu(gravity=GRAVITY)
    assert_within_sigma(result.accel.triad, result.accel.sigma, ACCEL)
    assert result.gyro is None and set(result.as_json()["covariance"]) == {"order", "accel"}
    assert all(name.startswith("accel") for name in result.effect_parameters())
    assert "16 poses" in repr(result) and "accel_bias" in result._repr_html_()


def table_record(rng, attitudes, rate, latitude, noise):
    """Return times and readings of a gyro that a table turns about the vertical, pose after pose."""
    still, turning = np.zeros((100, 1)), np.full((200, 1), rate)
    earth = EARTH * np.array([0.0, np.cos(latitude), np.sin(latitude)])
    # The table's turns average the horizontal part of Earth rate.
    parts = [
        pose.inv().apply(np.vstack([still, turning]) * [0.0, 0.0, 1.0] + earth * [0.0, 0.0, 1.0])
        for pose in attitudes
    ]
    true = np.concatenate(parts)
    return 0.02 * np.arange(len(true)), GYRO.measure(true) + noise * rng.standard_normal(true.shape)


def test_a_gyro_alone_is_calibrated_by_the_rate_of_a_table():
    rng = np.random.default_rng(4)
    t, gyro = table_record(rng, Rotation.random(16, rng=rng), 1.0, 0.8, 1e-3)
    result = hubodo.from_arrays(gyro=gyro, t=t).calibrate_imu(table_rate_deg_s=np.degrees(1.0))
    assert_within_sigma(result.gyro.triad, np.sqrt(np.diag(result.gyro.covariance)), GYRO)
    assert result.as_json()["notes"][0].startswith("gyros: table rate of 1 rad/s in 16 steady turns")


def test_a_precise_gyro_alone_is_calibrated_by_earth_rate():
    rng, errors = np.random.default_rng(5), Errors((2e-5, -1e-5, 1e-5), (0.01, -0.02, 0.005))
    true = np.concatenate(
        [
            np.tile(pose.inv().apply([0, 0.6 * EARTH, 0.8 * EARTH]), (400, 1))
            for pose in Rotation.random(16, rng=rng)
        ]
    )
    gyro = errors.measure(true) + 2e-6 * rng.standard_normal(true.shape)
    # A short turn separates the poses.
    gyro[np.arange(len(gyro)) % 400 < 20] += 0.5 * rng.standard_normal(((len(gyro)) // 20, 3))
    result = hubodo.from_arrays(gyro=gyro, t=0.02 * np.arange(len(gyro))).calibrate_imu()
    assert_within_sigma(result.gyro.triad, np.sqrt(np.diag(result.gyro.covariance)), errors)


def test_a_noisy_gyro_alone_and_a_single_axis_are_refused_with_what_to_give():
    data = carry(np.random.default_rng(6), GYRO, ACCEL, poses=9, dt=0.02, standstill_s=3.0)
    with pytest.raises(CalibrationError, match="--table-rate-deg-s"):
        hubodo.from_arrays(gyro=data.gyro, t=data.t).calibrate_imu()
    with pytest.raises(InputError, match=r"accelerometer z alone.*--means"):
        hubodo.from_arrays(accel=data.accel[:, 2], t=data.t, channel="az").calibrate_imu()
