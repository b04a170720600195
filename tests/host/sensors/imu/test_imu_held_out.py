"""A real Xsens MTi turned by hand (imu_tk): errors before and after, in held-out poses and turns."""

import numpy as np

import wanted
from hubodo.log.csv_folder import read_folder
from hubodo.sensors.imu.calibrate import calibrate_imu
from hubodo.sensors.imu.scalar_calibration import fit_scalar_calibration
from hubodo.sensors.imu.standstills import find_standstills

GRAVITY = 9.81744


def test_length_and_turns_agree_on_what_was_not_fitted():
    node = read_folder(wanted.recording("multipose")).nodes["node"]
    result = calibrate_imu(node.t, node.gyro, node.accel, gravity=GRAVITY)
    held, turns = result.accel_held_out, result.gyro.held_out
    print(f"\nrests {len(result.standstills)}, condition number {result.accel.poses.condition:.3g}")
    print(f"length less gravity, held out: {held.rms_before:.4f} before, {held.rms:.4f} m/s² rms after")
    print(
        f"turns, held out: {np.degrees(turns.rms_before):.2f} before, {np.degrees(turns.rms):.3f} degrees "
        f"rms after"
    )
    assert len(held.error) == len(result.standstills) >= 30
    assert held.rms < 0.01 and held.rms_before > 0.5
    assert np.degrees(turns.error.max()) < 0.5
    assert len(turns.error) == len(result.standstills) - 1


def test_the_first_minutes_predict_the_last_rests():
    node = read_folder(wanted.recording("multipose")).nodes["node"]
    standstills = find_standstills(node.t, node.gyro, node.accel)
    first, last = (
        standstills.select(standstills.t[:, 0] < 340),
        standstills.select(standstills.t[:, 0] >= 340),
    )
    result = fit_scalar_calibration(first.accel, GRAVITY, first.accel_sigma)
    error = np.linalg.norm(result.triad.correct(last.accel), axis=1) - GRAVITY
    assert np.sqrt(np.mean(error**2)) < 0.01
