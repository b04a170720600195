"""Logs of a gyro alone and of a stationary vehicle: missing and undefined results are named."""

import json
from pathlib import Path

import numpy as np
import pytest

from in_process import hubodo
from vehicles import vehicle_toml

N = 3000
NOISE = np.random.default_rng(1).normal(0.0, 1e-3, (N, 3))
T = np.arange(N) / 100.0


def write_csv(path: Path, names: str, *columns: np.ndarray) -> Path:
    rows = [",".join(f"{value:.7f}" for value in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([names, *rows, ""]))
    return path


@pytest.mark.parametrize("axes", ["xyz", "z"])
def test_a_report_of_a_gyro_alone_shows_its_noise_and_names_what_is_missing(axes, tmp_path):
    names = ",".join(f"g{axis}" for axis in axes)
    log = write_csv(tmp_path / "gyro.csv", f"t,{names}", T, NOISE[:, : len(axes)])
    done = hubodo("report", log, "-o", tmp_path / "r.html", "--json")
    assert done.code == 0, done.err
    report = json.loads(done.out)
    assert "gyro: stationary during the whole record, 30 s" in report["facts"]
    assert any(line.startswith("gyro gz: ") for line in report["facts"])
    absent = [f"g{axis}" for axis in "xyz" if axis not in axes] + ["ax", "ay", "az"]
    assert f"gyro: {', '.join(absent)}: the log contains no samples" in report["missing"]
    assert "gyro: scale and cross-axis of the triads: all six channels are needed" in report["missing"]


def test_the_report_of_a_rotated_gyro_alone_names_why_standstills_are_unknown(tmp_path):
    turning = NOISE[:, 0] + np.where((T > 10.0) & (T < 20.0), np.sin(T), 0.0)
    log = write_csv(tmp_path / "gyro.csv", "t,gz", T, turning)
    report = json.loads(hubodo("report", log, "-o", tmp_path / "r.html", "--json").out)
    assert any("standstills can only be detected with all six channels" in it for it in report["missing"])


def test_the_error_of_a_stationary_vehicle_has_no_percentage(tmp_path):
    log, n = tmp_path / "log", 250  # too few samples for the noise, which this test does not need
    log.mkdir()
    for node in ("left", "right"):
        accel = np.column_stack([np.zeros(n), np.full(n, 9.8), np.zeros(n)]) + 9.0 * NOISE[:n]
        write_csv(log / f"{node}.csv", "t,gx,gy,gz,ax,ay,az", T[:n], NOISE[:n], accel)
    write_csv(log / "truth.csv", "t,x,y,heading", T[:n:10], *np.zeros((3, n // 10)))
    (tmp_path / "v.toml").write_text(vehicle_toml())
    command = ("fuse", log, "--vehicle", tmp_path / "v.toml", "-o", tmp_path / "out", "--force")
    truth = json.loads(hubodo(*command, "--json").out)["truth"]
    assert truth["final_error"] < 0.01
    assert [truth[f"{name}_percent"] for name in ("final", "rms", "maximum")] == [None] * 3
    output = hubodo(*command).out
    assert "nan" not in output
    assert "0.000 m, the vehicle does not move" in output
    report = ("report", log, "--vehicle", tmp_path / "v.toml", "-o", tmp_path / "r.html")
    assert "nan" not in hubodo(*report).out
    assert "nan" not in (tmp_path / "r.html").read_text()
