"""Uneven converters: their errors of the gyro bias and of accelerometers are covered, even ones not named."""

import numpy as np
import pytest

from generators.odd_records import correlated, low_pass, missing_codes
from generators.poses import Errors, carry
from hubodo.sensors.imu.calibrate import calibrate_imu
from hubodo.sensors.imu.standstills import Standstills
from hubodo.sensors.imu.uneven_codes import uneven_code_sigma, widen_accelerometers

POSES, COUNT, NOISE = 24, 300, 4e-3
T = np.arange(POSES * COUNT) * 0.02


def judge(gyro):
    """Return the sigmas and notes of a record of poses without turns between them."""
    edges = np.arange(0, len(T), COUNT)
    means = gyro.reshape(POSES, COUNT, 3).mean(axis=1)
    at = Standstills(edges, edges + COUNT, T[edges], means, means, means, means, ())
    notes = []
    return uneven_code_sigma(gyro, at, notes), notes


def standing(rng):
    return rng.uniform(-0.02, 0.02, 3) + NOISE * rng.standard_normal((len(T), 3))


def plain(gyro, rng):
    return gyro


def drifting(gyro, rng):
    return gyro + np.repeat(NOISE * rng.standard_normal((POSES, 3)), COUNT, axis=0)


def with_slow_noise(gyro, rng):
    return gyro + np.stack([correlated(T, rng, NOISE / 3) for _ in range(3)], axis=1)


def filtered(gyro, rng):
    return low_pass(T, gyro, gyro, rng, 0.0)[1]


@pytest.mark.parametrize("steps", [0.0, 0.2, 0.7, 1.0, 2.0, 6.0])
@pytest.mark.parametrize("change", [plain, drifting, with_slow_noise, filtered])
def test_even_codes_have_no_part_in_the_sigma(change, steps):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        gyro = change(standing(rng), rng)
        step = steps * NOISE
        sigma, notes = judge(step * np.rint(gyro / step) if step else gyro)
        assert not sigma.any() and not notes


def test_the_error_of_uneven_and_missing_codes_is_covered():
    pulls = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        gyro = standing(rng)
        converted = missing_codes(T, gyro, None, rng, 0.0)[1]
        sigma, notes = judge(converted)
        pulls.append((converted - gyro).mean(axis=0) / np.maximum(sigma, 1e-5))
        assert len(notes) <= 1
    assert np.mean(np.abs(pulls) < 1.96) > 0.9


@pytest.mark.parametrize("is_uneven", [False, True])
def test_the_error_of_uneven_codes_is_part_of_each_pose_of_the_accelerometers(is_uneven):
    pulls, named, even = [], 0, np.zeros((POSES, 3))
    for seed in range(6):
        rng = np.random.default_rng(seed)
        accel = np.repeat(rng.uniform(-9.8, 9.8, (POSES, 3)), COUNT, axis=0)
        accel += np.repeat(rng.uniform(0.007, 0.013, POSES), COUNT)[:, None] * rng.standard_normal(
            accel.shape
        )
        converted = missing_codes(T, accel, None, rng, 0.0)[1] if is_uneven else 0.01 * np.rint(accel / 0.01)
        edges = np.arange(0, len(T), COUNT)
        at = Standstills(edges, edges + COUNT, T[edges], even, even, even, np.full((POSES, 3), 1e-5))
        widened = widen_accelerometers(converted, at)
        named += any("the codes of the accelerometers' converter" in note for note in widened.rejected)
        pulls.append((converted - accel).reshape(POSES, COUNT, 3).mean(axis=1) / widened.accel_sigma)
    assert named == (6 if is_uneven else 0)
    if is_uneven:
        assert 0.8 < np.sqrt(np.mean(np.square(pulls))) < 1.2


def test_a_calibration_with_uneven_codes_names_them_and_stays_within_sigma():
    rng = np.random.default_rng(5)
    gyro = Errors((0.01, -0.02, 0.015), (0.01, -0.01, 0.005))
    data = carry(rng, gyro, Errors((0.1, -0.05, 0.2)), dt=0.02)
    result = calibrate_imu(data.t, missing_codes(data.t, data.gyro, None, rng, 0.0)[1], data.accel)
    assert any("the codes of the gyros' converter are uneven by" in note for note in result.notes)
    error, sigma = result.gyro.triad.bias - gyro.b, np.sqrt(np.diag(result.gyro.covariance)[:3])
    assert np.all(np.abs(error) < 3.0 * sigma) and np.abs(error).max() > 2e-4
