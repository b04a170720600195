"""Folders of phone apps: recognised by their headers, forces interpolated to the times of the gyro."""

import numpy as np
import pytest

from hubodo.cli import main
from hubodo.errors import InputError
from hubodo.log.any_log import read_log

STAMP = 1772366400_250_000_000
T = np.arange(300) * 0.01
RATE = np.sin(T)


def write_csv(path, header, columns, delimiter=","):
    rows = [delimiter.join(map(str, row)) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n", "utf-8")


def sensor_logger(folder, name, t, x, y, z):
    """Write a file as Sensor Logger does: ns since 1970, seconds since the start, axes in reverse."""
    stamps = [STAMP + round(1e9 * value) for value in t]
    write_csv(
        folder / f"{name}.csv", "time,seconds_elapsed,z,y,x", (stamps, t.tolist(), z.tolist(), y, x.tolist())
    )


def phyphox(folder, name, quantity, unit, t, axes):
    header = ",".join(['"Time (s)"', *(f'"{quantity} {axis} ({unit})"' for axis in "xyz")])
    write_csv(folder / f"{name}.csv", header, [t.tolist(), *(axis.tolist() for axis in axes)])


def test_sensor_logger_gives_axes_date_and_forces_with_gravity(tmp_path):
    zeros = np.zeros(len(T))
    sensor_logger(tmp_path, "Gyroscope", T + 0.1, RATE, zeros, 2.0 * RATE)
    coarse = np.arange(0.0, 3.3, 0.02)
    none = np.zeros(len(coarse))
    sensor_logger(tmp_path, "Accelerometer", coarse, 0.5 * coarse, none, none)
    sensor_logger(tmp_path, "Gravity", coarse, none, none, none + 9.81)
    recording = read_log(tmp_path)
    table = recording.nodes["phone"]
    assert table["gx"] == pytest.approx(RATE) and table["gz"] == pytest.approx(2.0 * RATE)
    assert table["ax"] == pytest.approx(0.5 * table.t, abs=1e-9) and table["az"] == pytest.approx(9.81)
    assert abs(recording.t_zero_ns - STAMP) <= 256
    assert not recording.warnings


def test_phyphox_is_read_by_its_units(tmp_path):
    zeros = np.zeros(len(T))
    phyphox(tmp_path, "Gyroscope", "Gyroscope", "deg/s", T, (RATE, zeros, zeros))
    phyphox(tmp_path, "Accelerometer", "Acceleration", "m/s^2", T, (zeros, zeros, zeros + 9.8))
    table = read_log(tmp_path).nodes["phone"]
    assert table["gx"] == pytest.approx(np.radians(RATE))
    assert table["az"] == pytest.approx(9.8)


def test_an_acceleration_without_gravity_is_left_out(tmp_path, capsys):
    zeros = np.zeros(len(T))
    sensor_logger(tmp_path, "Gyroscope", T, RATE, zeros, zeros)
    sensor_logger(tmp_path, "Accelerometer", T, RATE, zeros, zeros)
    recording = read_log(tmp_path)
    assert "it lacks gravity; record Gravity.csv" in recording.warnings[0]
    assert np.isnan(recording.nodes["phone"]["ax"]).all()
    assert main(["import", str(tmp_path), "-o", str(tmp_path / "phone.mcap")]) == 0
    assert "phone: 300 rows" in capsys.readouterr().out
    assert read_log(tmp_path / "phone.mcap").nodes["phone"]["gx"] == pytest.approx(RATE)


def test_another_folder_with_a_file_of_that_name_is_a_csv_folder(tmp_path):
    (tmp_path / "Gyroscope.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match=r"has 2 columns \(a, b\); name them"):
        read_log(tmp_path)
