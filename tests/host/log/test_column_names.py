"""Headings of other programs, and files with dates, decimal commas, rows of units and A/D counts."""

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.log.column_names import parse_heading
from hubodo.log.number_recording import InputFormat

DEG = np.pi / 180.0


@pytest.mark.parametrize(
    ("heading", "name", "unit"),
    [
        ("t", "t", ""),
        ("Time (s)", "t", "s"),
        ("timestamp_us", "t", "us"),
        ("timestamp [ms]", "t", "ms"),
        ("seconds_elapsed", "t", "s"),
        ("Gyroscope x (rad/s)", "gx", "rad/s"),
        ("gyro_y", "gy", ""),
        ("GyrZ [dps]", "gz", "dps"),
        ("imu.angular_velocity.z", "gz", ""),
        ("/imu/acc_x", "ax", ""),
        ("Acceleration z (m/s^2)", "az", "m/s^2"),
        ("Linear Acceleration z (m/s^2)", "", "m/s^2"),
        ("Temperature (°C)", "temperature", "°C"),
        ("gyro[0]", "gx", ""),
        ("mag_x", "", ""),
        ("x", "", ""),
    ],
)
def test_a_heading_is_a_channel_a_time_or_another_quantity(heading, name, unit):
    column = parse_heading(heading)
    assert (column.name, column.unit) == (name, unit)


def read_text(tmp_path, text, **options):
    path = tmp_path / "lab.csv"
    path.write_text(text, "utf-8")
    recording = read_log(path, input_format=InputFormat(**options))
    return recording, recording.nodes["lab"]


def test_decimal_commas_and_a_row_of_units(tmp_path):
    text = "timestamp_ms;gx;acc_z\n[ms];[deg/s];[mg]\n0;1,5;1000\n10;-2,25;999,5\n"
    _, table = read_text(tmp_path, text)
    assert table.t.tolist() == [0.0, 0.01]
    assert table["gx"] == pytest.approx(np.array([1.5, -2.25]) * DEG)
    assert table["az"] == pytest.approx(np.array([1.0, 0.9995]) * 9.80665)
    assert np.isnan(table["gy"]).all()


@pytest.mark.parametrize(
    "stamps",
    [
        ("2026-03-01T12:00:00.250", "2026-03-01T12:00:00.260"),
        ("2026-03-01 13:00:00.250+01:00", "2026-03-01 13:00:00.260+01:00"),
        ("1772366400.250", "1772366400.260"),
        ("1772366400250", "1772366400260"),
        ("1772366400250000000", "1772366400260000000"),
    ],
)
def test_dates_and_times_since_1970_begin_below_one_second(tmp_path, stamps):
    recording, table = read_text(tmp_path, f"timestamp,gx\n{stamps[0]},1\n{stamps[1]},2\n", units=("deg/s",))
    assert table.t == pytest.approx([0.25, 0.26], abs=1e-6)
    assert recording.t_zero_ns == 1772366400 * 10**9


def test_counts_have_a_zero_and_a_scale_by_channel(tmp_path):
    text = "time,gx,gy\n0,2058,2045\n1,2048,2044\n"
    options = {"zeros": {"gx": 2048.0, "gy": 2045.0}, "scales": {"gx": 0.5, "gy": 2.0}}
    _, table = read_text(tmp_path, text, units=("deg/s",), **options)
    assert table["gx"] == pytest.approx(np.array([5.0, 0.0]) * DEG)
    assert table["gy"] == pytest.approx(np.array([0.0, -2.0]) * DEG)


def test_of_two_times_that_in_seconds_is_used_and_a_repeated_channel_is_refused(tmp_path):
    stamp = 1772366400250000000
    text = f"time,seconds_elapsed,gx (rad/s)\n{stamp},0.25,1\n{stamp + 10**7},0.26,2\n"
    recording, table = read_text(tmp_path, text)
    assert table.t.tolist() == [0.25, 0.26] and recording.t_zero_ns == 0
    with pytest.raises(InputError, match=r"both gx and gyro_x are gx; choose with --columns"):
        read_text(tmp_path, "t,gx,gyro_x\n0,1,2\n1,1,2\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("timestamp,gx\n0,1\n1,2\n", "the unit of gx is missing; give --unit"),
        ("time (h),gx\n0,1\n1,2\n", r"time \(h\) is in h; times must be in s, ms"),
        ("t;gx\n[1];rad/s\n", "no row below the units"),
        ("t;gx\n0,5;1,0\n0,6;nine\n", "row 3: 'nine' is not a number"),
        ("stamp,rate,mark\n0,1,2\n1,1,2\n", "name them, as in --columns"),
    ],
)
def test_what_is_missing_is_asked_for_by_the_name_of_the_option(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read_text(tmp_path, text)
