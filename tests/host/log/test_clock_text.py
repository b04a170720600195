"""Dates and times of day in number files: one clock, across midnight, without a guess of the order."""

import numpy as np
import pytest

from hubodo.log.any_log import read_log
from hubodo.log.clock_text import clock_format
from hubodo.units import NS_PER_S

T = np.arange(4) * 0.25
MIDNIGHT_S = 1_773_532_800  # 2026-03-15 in UTC
STAMPS = ("59.500", "59.750", "00.000", "00.250")
HOURS = ("23:59", "23:59", "0:00", "0:00")
"""Half a second before and after the midnight of 14 to 15 March 2026."""


def rows_of(date, *, comma=False, twelve=False):
    """Yield date and time of each row; `date` has the place of the day as {}."""
    for k in range(4):
        hour = HOURS[k]
        if twelve:
            hour = hour.replace("23:", "11:") if k < 2 else "12:00"
        time = f"{hour}:{STAMPS[k]}" + (" PM" if k < 2 else " AM") * twelve
        yield date.format(14 + k // 2), time.replace(".", ",") if comma else time


def read_table(path, header, rows, delimiter):
    gyro = [f"{x:.4f}" for x in (0.5, -0.25, 0.125)]
    cells = [[*row, *(it.replace(".", ",") if delimiter == ";" else it for it in gyro)] for row in rows]
    path.write_text("\n".join([header, *map(delimiter.join, cells)]) + "\n")
    return read_log(path)


@pytest.mark.parametrize(
    ("header", "date", "options", "delimiter"),
    [
        ("Datum;Uhrzeit;GyroX (rad/s);GyroY (rad/s);GyroZ (rad/s)", "{}.03.2026", {"comma": True}, ";"),
        ("date,time,gx_rads,gy_rads,gz_rads", "03/{}/2026", {"twelve": True}, ","),
        ("Day,Clock,gyro_x_rad,gyro_y_rad,gyro_z_rad", "{}/3/2026", {}, ","),
        ("day,time,gyro_x_rad,gyro_y_rad,gyro_z_rad", "2026-03-{}", {}, ","),
    ],
)
def test_date_and_time_in_two_columns_are_one_clock(tmp_path, header, date, options, delimiter):
    recording = read_table(tmp_path / "a.csv", header, rows_of(date, **options), delimiter)
    (table,) = recording.nodes.values()
    start_s = recording.t_zero_ns / NS_PER_S + table.t[0]
    np.testing.assert_allclose(start_s + table.t - table.t[0], MIDNIGHT_S - 0.5 + T, atol=1e-6)
    np.testing.assert_allclose(table.gyro, [(0.5, -0.25, 0.125)] * 4)


def test_date_and_time_in_one_column_need_no_name(tmp_path):
    rows = [(" ".join(row),) for row in rows_of("{}.03.2026", comma=True)]
    header = "Zeit;GyroX (rad/s);GyroY (rad/s);GyroZ (rad/s)"
    recording = read_table(tmp_path / "a.csv", header, rows, ";")
    assert recording.t_zero_ns == (MIDNIGHT_S - 1) * NS_PER_S
    np.testing.assert_allclose(recording.nodes["a"].t, T + 0.5, atol=1e-6)


@pytest.mark.parametrize("date", ["05/04/2026", ""])
def test_without_a_known_day_the_time_counts_from_midnight_and_days_by_midnights(tmp_path, date):
    rows = [(date, time) if date else (time,) for _, time in rows_of("{}")]
    header = ("date," if date else "") + "time,gx_rads,gy_rads,gz_rads"
    recording = read_table(tmp_path / "a.csv", header, rows, ",")
    assert recording.t_zero_ns == 0, "5 April or 4 May is not guessed"
    np.testing.assert_allclose(recording.nodes["a"].t, 86_400 - 0.5 + T, atol=1e-6)


@pytest.mark.parametrize(
    "cell", ["31.02.2026", "14/14/2026", "14.3.26", "24:00:00", "13:00 PM", "1:2", "20260314"]
)
def test_what_is_no_date_or_time_is_not_read_as_one(cell):
    assert clock_format(cell) is None
