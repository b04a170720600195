"""Logs from data frames and arrays: the same channels, units and times as from a file."""

import numpy as np
import pandas as pd
import pytest

import hubodo

DEG = np.pi / 180.0
RNG = np.random.default_rng(8)
GYRO = RNG.normal(0.0, 0.1, (1200, 3))
T = np.arange(1200) * 0.01


def test_a_frame_of_a_log_is_that_log_again():
    table = hubodo.Table(
        {"t": T, **dict(zip(("gx", "gy", "gz"), GYRO.T, strict=True)), "ax": T, "ay": T, "az": T + 9.81}
    )
    log = hubodo.from_frame(table.frame(), node="left")
    assert list(log["left"]) == list(table)
    assert all(np.array_equal(log["left"][name], table[name]) for name in table)


@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_dates_of_the_index_are_times_of_the_log(zone):
    stamps = pd.date_range("2026-03-01 12:00:00.25", periods=len(T), freq="10ms", tz=zone)
    frame = pd.DataFrame(GYRO, columns=["gyro_x (deg/s)", "gyro_y (deg/s)", "mark"], index=stamps)
    log = hubodo.from_frame(frame)
    assert log["imu"].t == pytest.approx(T + 0.25, abs=1e-9)
    assert log["imu"]["gy"] == pytest.approx(GYRO[:, 1] * DEG)
    assert "left out: mark" in log.warnings[0]
    first = log.frame(utc=True).index[0]
    assert first == (stamps[0].tz_localize("UTC") if zone is None else stamps[0].tz_convert("UTC"))


def test_counts_in_a_column_of_a_frame_without_times():
    frame = pd.DataFrame({"adc": 2048 + np.arange(500), "note": "x"})
    log = hubodo.from_frame(
        frame, columns=["gx", "-"], rate=50.0, units="deg/s", zeros={"gx": 2048}, scales={"gx": 0.1}
    )
    assert log["imu"]["gx"] == pytest.approx(0.1 * np.arange(500) * DEG)
    assert log.duration == pytest.approx(499 / 50.0)


def test_arrays_equal_a_file_with_the_same_numbers(tmp_path):
    path = tmp_path / "imu.csv"
    np.savetxt(path, np.c_[T, GYRO], delimiter=",", header="t,gx,gy,gz", comments="", fmt="%.17g")
    from_file = hubodo.open(path, units=["deg/s"]).allan(channel="gy")
    from_arrays = hubodo.from_arrays(GYRO, t=T, units="deg/s").allan(channel="gy")
    assert np.array_equal(from_arrays.adev, from_file.adev)
    assert hubodo.from_arrays(GYRO[:, 0], rate=100.0, channel="gx")["imu"]["gx"] == pytest.approx(GYRO[:, 0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: hubodo.from_arrays(GYRO), "has no time column"),
        (lambda: hubodo.from_arrays(t=T), "no samples: give gyro"),
        (lambda: hubodo.from_arrays(GYRO[:, :2], t=T), r"gyro has shape \(1200, 2\)"),
        (lambda: hubodo.from_arrays(GYRO, t=T[:5]), "differ in length"),
        (lambda: hubodo.from_frame(pd.DataFrame({"t": T, "gyro_x": T})), "the unit of gx is missing"),
        (lambda: hubodo.from_frame(pd.DataFrame({"t": ["a"], "gx": [1]})), "'t' does not hold numbers"),
        (lambda: hubodo.from_arrays(GYRO, t=T).save("x"), None),
    ],
)
def test_what_is_missing_is_named(call, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if message is None:
        assert call().name == "x"
        return
    with pytest.raises(hubodo.HubodoError, match=message):
        call()
