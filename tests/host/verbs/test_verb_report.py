"""`hubodo report`: one page that says what a log shows, and what it does not."""

import argparse
import re
import shutil

import numpy as np
import pytest

from generators.fake_drive import VEHICLE_TOML, short_drive
from hubodo.calibration.file import (
    CalibratedEffect,
    Calibration,
    NodeCalibration,
    Quantity,
    format_calibration,
)
from hubodo.cli import main
from hubodo.errors import CalibrationError, InputError
from hubodo.log.csv_folder import write_folder
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Event, Recording, Table
from hubodo.verbs import VERBS
from hubodo.verbs.report import add_arguments, run

COLUMNS = ("t", "gx", "gy", "gz", "ax", "ay", "az")


def report(*arguments):
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return run(parser.parse_args([str(word) for word in arguments]))


def static_node(rng, seconds=90.0, rate=50.0, warm_up=0.0):
    t = np.arange(0.0, seconds, 1.0 / rate)
    gyro = 1e-3 * rng.standard_normal((len(t), 3)) + 0.01
    gyro[:, 2] += warm_up * -np.expm1(-t / 15.0)
    accel = 0.01 * rng.standard_normal((len(t), 3)) + [0.0, 0.0, 9.80665]
    return Table(
        dict(zip(COLUMNS, np.column_stack([t, gyro, accel]).T, strict=True))
        | {"temperature": 25.0 + 0.001 * t}
    )


def drive_recording(seed):
    drive = short_drive(seed)
    nodes = {
        name: Table(
            dict(zip(COLUMNS, np.column_stack([np.round(n.t + 1, 9), n.gyro, n.accel]).T, strict=True))
        )
        for name, n in drive.nodes.items()
    }
    rows = slice(None, None, 20)
    truth = Table(
        {"t": drive.t[rows] + 1, "x": drive.x[rows], "y": drive.y[rows], "heading": drive.heading[rows]}
    )
    return Recording(nodes, truth=truth)


def test_the_report_of_a_drive_shows_its_error_and_names_missing_data(tmp_path):
    log, vehicle = tmp_path / "drive.mcap", tmp_path / "v.toml"
    write_recording(drive_recording(21), log)
    vehicle.write_text(VEHICLE_TOML)
    result = report(log, "--vehicle", vehicle, "-o", tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text("utf-8")
    assert result.size == len(page.encode())
    assert any("drive of" in line for line in result.facts)
    (error,) = (line for line in result.facts if line.startswith("position error at the end"))
    assert float(re.search(r"([\d.]+) % of the path", error)[1]) < 3.0, f"seed 21: {error}"
    (value,) = set(re.findall(r"track_width.error</td><td[^>]*>([^<]+)<", page))
    estimate, sigma = value.lstrip("(").split("e")[0].rstrip(")").split(" ± ")
    assert len(estimate.partition(".")[2]) == len(sigma.partition(".")[2]), (
        f"as many digits as its sigma: {value}"
    )
    missing = " ".join(result.missing)
    for part in (
        "calibration: none",
        "temperature: none",
        "north",
        "health",
        "warm-up",
        "scale and cross-axis",
    ):
        assert part in missing
    # The page is self-contained and loads nothing.
    assert not re.search(r'(?:src|href)="(?:https?:)?//', page) and "<script" not in page
    assert result.size < 1_000_000
    assert page.count('class="on-wide"') >= 2, "one figure for the path, one for the speed"
    assert "heading, °" in page and "odometry" in page and "truth" in page
    for heading in ("Findings", "Gaps and losses", "Drive", "Not available from this log"):
        assert f"<h2>{heading}" in page


def test_the_report_of_a_static_node_shows_noise_and_warm_up(tmp_path):
    rng = np.random.default_rng(4)
    write_folder(Recording({"bench": static_node(rng, 120.0, warm_up=0.02)}), tmp_path / "csv")
    result = report(tmp_path / "csv", "-o", tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text("utf-8")
    assert any(line.startswith(("bench: stationary", "bench: standstills")) for line in result.facts)
    assert "bench: noise" in page
    assert any(line.startswith("bench gz: The bias starts at") for line in result.facts), result
    assert any("arrival times" in line for line in result.missing)
    assert any("vehicle" in line for line in result.missing)


def test_gaps_and_the_calibration_in_use_are_in_the_page(tmp_path):
    rng = np.random.default_rng(6)
    node = static_node(rng, 60.0)
    keep = (node.t < 30.0) | (node.t > 31.0)
    table = Table({name: column[keep] for name, column in node.columns.items()})
    zero = 1_700_000_000 * 10**9
    gap = Event(
        zero + 30 * 10**9,
        "gap",
        "left",
        "left: 50 samples lost",
        {"node": "left", "cause": "link down", "samples_lost": 50, "frames_lost": 6, "duration_s": 1.0},
    )
    write_recording(Recording({"left": table}, events=(gap,), t_zero_ns=zero), tmp_path / "log.mcap")
    bias = CalibratedEffect({"z": Quantity(0.01, 0.001)}, "rests", "", "2026-01-02", (20.0, 30.0))
    calibration = Calibration({"left": NodeCalibration({"gyro_bias": bias}, "aa01")})
    (tmp_path / "c.toml").write_text(format_calibration(calibration))
    report(tmp_path / "log.mcap", "--calibration", tmp_path / "c.toml", "-o", tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text("utf-8")
    assert "link down" in page
    assert "z +0.0100 ± 0.0010" in page
    assert "2026-01-02 rests" in page


def test_the_calibration_of_another_node_is_refused(tmp_path):
    recording = Recording(
        {"left": static_node(np.random.default_rng(1), 20.0)}, metadata={"serial.left": "bb02"}
    )
    write_recording(recording, tmp_path / "log.mcap")
    effects = {"gyro_bias": CalibratedEffect({"z": Quantity(0.01, 0.001)})}
    calibration = Calibration({"left": NodeCalibration(effects, "aa01")})
    (tmp_path / "c.toml").write_text(format_calibration(calibration))
    with pytest.raises(CalibrationError, match=r"aa01.*bb02"):
        report(tmp_path / "log.mcap", "--calibration", tmp_path / "c.toml", "-o", tmp_path / "r.html")
    assert not (tmp_path / "r.html").exists()


def test_a_page_is_not_overwritten_unless_asked(tmp_path, capsys):
    recording = Recording({"left": static_node(np.random.default_rng(1), 10.0)})
    write_folder(recording, tmp_path / "csv")
    page = tmp_path / "r.html"
    page.write_text("mine", "utf-8")
    assert main(["report", str(tmp_path / "csv"), "-o", str(page)]) == 2
    assert "--force" in capsys.readouterr().err
    assert page.read_text("utf-8") == "mine"
    assert main(["report", str(tmp_path / "csv"), "-o", str(page), "--force"]) == 0
    assert "Findings" in page.read_text("utf-8")
    shutil.rmtree(tmp_path / "csv")
    with pytest.raises(InputError, match="folder"):
        report(tmp_path / "csv", "-o", tmp_path / "no" / "r.html")


def test_report_is_a_verb():
    assert "report" in VERBS
