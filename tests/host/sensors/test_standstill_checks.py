"""Standstill checks: wrong units by magnitude, motion, temperature steps."""

import numpy as np
import pytest

import wanted
from hubodo.errors import InputError
from hubodo.sensors.standstill_checks import (
    check_standstill,
    check_units,
    find_temperature_step,
    first_disturbance,
)

DEG = np.pi / 180.0


def still(seed=0, count=6000):
    rng = np.random.default_rng(seed)
    gyro = rng.normal([0.01, -0.02, 0.005], 0.1 * DEG, (count, 3))
    accel = rng.normal([0.3, -0.2, 9.8], 0.02, (count, 3))
    return np.arange(count) * 0.01, gyro, accel


@pytest.mark.parametrize(
    ("gyro_factor", "accel_factor", "words"),
    [
        (1.0, 1 / 9.80665, "that is g; give its unit"),
        (1.0, 1000 / 9.80665, "that is mg; give its unit"),
        (180 / np.pi, 1.0, "it looks like deg/s"),
        (180e3 / np.pi, 1.0, "it looks like mdeg/s"),
    ],
)
def test_a_wrong_unit_is_named_from_the_magnitude(gyro_factor, accel_factor, words):
    _, gyro, accel = still()
    check_units(gyro, accel)
    with pytest.raises(InputError, match=words):
        check_units(gyro * gyro_factor, accel * accel_factor)


def test_raw_counts_are_recognised():
    _, gyro, accel = still()
    with pytest.raises(InputError, match="raw counts"):
        check_units(gyro, np.rint(accel / 9.80665 * 16384))
    with pytest.raises(InputError, match="raw counts"):
        check_units(np.rint(gyro * 3000), accel)


@pytest.mark.parametrize("seed", range(10))
def test_a_turn_a_knock_and_a_tilt_are_movement_and_noise_is_not(seed):
    t, gyro, accel = still(seed)
    rows = np.hstack([gyro, accel])
    assert first_disturbance(t, rows) is None, seed
    turned = rows.copy()
    turned[3000:3200, 2] += 0.05
    knocked = rows.copy()
    knocked[2500:2540, 3] += np.random.default_rng(seed).normal(0, 2.0, 40)
    tilted = rows.copy()
    tilted[4000:, 3] += 0.2
    for built, when in ((turned, 30.0), (knocked, 25.0), (tilted, 40.0)):
        start, end = first_disturbance(t, built)
        assert start <= when <= end, (seed, when)
    with pytest.raises(InputError, match=r"moved between .* --end"):
        check_standstill(t, turned)


def test_slow_drifts_coarse_steps_and_single_outliers_are_no_movement():
    t, gyro, accel = still()
    rows = np.hstack([gyro, accel])
    rows[:, 2] += 0.01 * (1 - np.exp(-t / 20))
    rows[1234, 0] = 0.5
    assert first_disturbance(t, rows) is None
    assert first_disturbance(t, np.rint(rows / 0.002) * 0.002) is None
    assert first_disturbance(t, np.rint(rows / 0.05) * 0.05) is None


def test_a_kick_across_two_seconds_is_movement():
    """Fifteen samples of 50 sigma in each of two seconds; a single one is an outlier."""
    t, gyro, accel = still()
    second = round(1.0 / (t[1] - t[0]))
    for count, is_movement in ((1, False), (15, True)):
        rows = np.hstack([gyro, accel])
        noise = float(np.std(np.diff(gyro[:, 2])))
        rows[40 * second - count : 40 * second + count, 2] += 50 * noise
        assert (first_disturbance(t, rows) is not None) == is_movement


def test_the_real_static_record_is_static_and_the_hand_rotated_one_is_not():
    rows = np.loadtxt(wanted.recording("static") / "node.csv.gz", delimiter=",", skiprows=1, max_rows=150_000)
    check_units(rows[:, 1:4], rows[:, 4:7])
    check_standstill(rows[:, 0], rows[:, 1:7])
    rows = np.loadtxt(wanted.recording("multipose") / "node.csv.gz", delimiter=",", skiprows=1, max_rows=8000)
    # The first turn by hand begins 51 s into the record.
    assert first_disturbance(rows[:, 0], rows[:, 1:7])[0] == pytest.approx(51.0, abs=1.0)


def test_a_temperature_step_is_detected_and_a_warm_up_is_not_one():
    t = np.arange(0.0, 3600.0, 1.0)
    noise = np.random.default_rng(0).normal(0, 0.1, len(t))
    warming = 22 + 20 * (1 - np.exp(-t / 900)) + noise
    assert find_temperature_step(t, warming) is None
    result = find_temperature_step(t, 25 + noise + 5.0 * (t > 1800))
    assert result.t == pytest.approx(1800, abs=70)
    assert result.change == pytest.approx(5.0, abs=0.3)
    # The temperature of a ventilated room reaches the part within minutes, not at once.
    slow = find_temperature_step(
        t, 25 + noise - np.where(t > 1800, 8.0 * (1 - np.exp(-(t - 1800) / 240)), 0.0)
    )
    assert slow.change < -1.5
