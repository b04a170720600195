"""`hubodo north` from a CSV folder to the JSON that other programs read."""

import json
from dataclasses import replace

import numpy as np
import pytest

import wanted
from generators.north_table import Sensor, carousel, maytag
from hubodo.cli import main
from hubodo.log.convert import write_recording
from hubodo.log.csv_folder import read_folder
from hubodo.log.csv_table import write_table
from hubodo.recording import Table

LATITUDE_DEG = 48.0
DT = 0.05
POINTS = [0.0, np.pi, np.pi / 2, 1.5 * np.pi]


def folder(path, run, *, table=True, y=None):
    path.mkdir()
    count = len(run.t)
    zero = np.zeros(count)
    rng = np.random.default_rng(0)
    accel = np.array([0, 0, 9.81]) + 0.01 * rng.standard_normal((count, 3))
    columns = {"t": run.t, "gx": run.rate, "gy": zero if y is None else y, "gz": run.vertical}
    write_table(path / "imu.csv", Table({**columns, "ax": accel[:, 0], "ay": accel[:, 1], "az": accel[:, 2]}))
    if table:
        moving = run.table_moving.astype(float)
        write_table(path / "table.csv", Table({"t": run.table_t, "angle": run.table_angle, "moving": moving}))
    return path


def stops(seed, azimuth_deg, count=20, points=POINTS):
    rng = np.random.default_rng(seed)
    error = Sensor(0.05, 0.2, 0.3).error(int(count * 22 / DT) + 10, DT, rng)
    angles = list(np.resize(points, count))
    return maytag(error, DT, np.radians(azimuth_deg), np.radians(LATITUDE_DEG), angles, 20.0, 2.0, rng=rng)


def north(capsys, path, *words):
    status = main(
        ["north", str(path), "--node", "imu", "--latitude_deg", str(LATITUDE_DEG), "--json", *words]
    )
    out, err = capsys.readouterr()
    return status, json.loads(out) if status == 0 else err


@pytest.mark.parametrize(
    "method, run",
    [
        ("maytag4", stops(1, 200.0)),
        ("maytag", stops(2, 60.0, points=POINTS[:2])),
        (
            "carousel",
            carousel(
                Sensor(0.05, 0.2, 0.3).error(8100, DT, np.random.default_rng(3)),
                DT,
                np.radians(310),
                np.radians(LATITUDE_DEG),
                40.0,
                400.0,
            ),
        ),
        ("east", stops(4, 30.0)),
    ],
)
def test_each_method_prints_the_fields_that_programs_read(tmp_path, capsys, method, run):
    status, found = north(capsys, folder(tmp_path / "log", run), "--axis", "x", "--method", method)
    assert status == 0, found
    truth = {"maytag4": 200.0, "maytag": 60.0, "carousel": 310.0, "east": 30.0}[method]
    off = (found["azimuth_deg"] - truth + 180) % 360 - 180
    assert abs(off) < 4 * found["sigma_deg"] < 40
    assert found["rate"] and all(abs(r) < 1e-3 for r in found["rate"])
    assert 350 < found["duration"] < 460
    gyro = found["gyros"][0]
    assert gyro["white_noise_bound_deg"] <= gyro["sigma_deg"] * 1.3
    if method.startswith("maytag"):
        assert set(gyro["filters"]) >= {"nearest", "swanson_schlamminger", "sliding_average"}
    if method == "maytag":
        assert len(gyro["candidates_deg"]) == 2 and "two azimuths" in found["warnings"][0]


def test_two_axes_of_a_node_are_fused_with_y_a_quarter_turn_on(tmp_path, capsys):
    azimuth = 120.0
    run = stops(5, azimuth)
    other = stops(6, azimuth)
    # The y axis looks a quarter turn anticlockwise: what x would feel with table zero 90 degrees less.
    left = stops(6, azimuth - 90.0)
    path = folder(tmp_path / "log", run, y=left.rate)
    status, both = north(capsys, path, "--axis", "x", "--axis", "y", "--method", "maytag4")
    assert status == 0, both
    assert abs(both["azimuth_deg"] - azimuth) < 4 * both["sigma_deg"]
    assert both["sigma_deg"] < min(g["sigma_deg"] for g in both["gyros"])
    assert len(other.t) == len(left.t)


@pytest.mark.parametrize(
    "words, text",
    [
        (["--axis", "z"], "degrees from level"),
        (["--method", "carousel"], "turns; a carousel needs 2"),
        (["--latitude_deg", "95"], "out of range"),
        (["--latitude_deg", "89.9"], "too near the pole"),
        (["--node", "left"], "no node 'left'"),
        (["--simulate_azimuth_deg", "10", "--stops", "2"], "give 4 stops"),
        (["--simulate_azimuth_deg", "10", "--stops", "200"], "too short for the programme"),
    ],
)
def test_wrong_use_is_refused_in_one_line(tmp_path, capsys, words, text):
    path = folder(tmp_path / "log", stops(7, 10.0, count=6, points=POINTS[:2]))
    status, err = north(capsys, path, *words)
    assert status == 2 and text in err and err.count("\n") == 1


def test_a_log_without_a_table_finds_its_stops_and_says_so(tmp_path, capsys):
    azimuth = 130.0
    run = stops(8, azimuth, count=12)
    with_table = folder(tmp_path / "with", run)
    status, known = north(capsys, with_table, "--method", "maytag4")
    status, found = north(capsys, folder(tmp_path / "log", run, table=False), "--method", "maytag4")
    assert status == 0 and any("angles are the gyro's" in text for text in found["warnings"])
    assert found["gyros"][0]["stops"]["count"] == 12
    assert abs(found["azimuth_deg"] - azimuth) < 4 * found["sigma_deg"]
    assert found["sigma_deg"] >= 0.9 * known["sigma_deg"]
    assert found["gyros"][0]["angle_sigma_deg"] > 0.1 > known["gyros"][0]["angle_sigma_deg"]
    # The same where table.csv is to be passed over, and exact angles where the table has steps.
    status, stepped = north(capsys, with_table, "--method", "maytag4", "--find-stops", "--step-deg", "90")
    assert status == 0 and stepped["gyros"][0]["angle_sigma_deg"] == 0.0


def test_the_whole_calibration_is_applied_and_said(tmp_path, capsys):
    """Bias, scale, what follows temperature, age and force: a log with all of them ends as one without."""
    rng = np.random.default_rng(11)
    run = stops(9, 250.0)
    clean = folder(tmp_path / "clean", run)
    table = read_folder(clean).nodes["imu"]
    warm = 25.0 + 5.0 * np.exp(-table.t / 100.0)
    heat, age, pull = 2e-5 * (warm - 25.0), 1e-4 * (1 - np.exp(-table.t / 200.0)), 3e-5 * table["ax"]
    spoilt = {**table.columns, "gx": 1.05 * table["gx"] + 0.01 + heat + age + pull, "temperature": warm}
    path = folder(tmp_path / "spoilt", run)
    write_table(path / "imu.csv", Table(spoilt))
    calibration = tmp_path / "c.toml"
    lines = {
        "gyro_bias": "x = { value = 0.01, sigma = 0 }",
        "gyro_scale_factor": "x = { value = 0.05, sigma = 0.001 }",
        "gyro_temperature": "x = { value = 2e-5, sigma = 0 }",
        "gyro_warmup": "x = { value = 1e-4, sigma = 0 }\ntime_constant = { value = 200, sigma = 0 }",
        "gyro_g_sensitivity": "xx = { value = 3e-5, sigma = 0 }",
    }
    text = "\n".join(f"[nodes.imu.effects.{name}]\n{line}" for name, line in lines.items())
    calibration.write_text(text)
    status, pure = north(capsys, clean, "--method", "maytag4")
    status, found = north(capsys, path, "--method", "maytag4", "--calibration", str(calibration))
    assert status == 0, found
    assert found["azimuth_deg"] == pytest.approx(pure["azimuth_deg"], abs=1e-6)
    assert set(found["calibration"]["imu"]["applied"]) == set(lines)
    assert any("not say when the node was switched on" in text for text in found["warnings"])
    assert rng is not None


@pytest.mark.parametrize(
    "body, text",
    [
        ("[nodes.imu]\nserial = 'aa55'\n", "is for the node with serial aa55, the log has 1234"),
        ("[nodes.left]\nserial = '1234'\n", "holds no node 'imu'; it has left"),
    ],
)
def test_a_calibration_of_another_node_is_refused(tmp_path, capsys, body, text):
    path = folder(tmp_path / "log", stops(8, 10.0, count=6))
    log = tmp_path / "log.mcap"
    recording = read_folder(path)
    write_recording(replace(recording, metadata={**recording.metadata, "serial.imu": "1234"}), log)
    (tmp_path / "c.toml").write_text(body + "[nodes.left.effects.gyro_bias]\nx = { value = 0, sigma = 0 }\n")
    status, err = north(capsys, log, "--calibration", str(tmp_path / "c.toml"))
    assert status == 2 and text in err and err.count("\n") == 1


def test_a_real_gyro_on_a_simulated_table_finds_north_within_its_sigma(capsys):
    path = wanted.recording("static")
    words = [
        "north",
        str(path),
        "--node",
        "node",
        "--latitude_deg",
        "32.7574",
        "--method",
        "maytag4",
        "--json",
    ]
    assert main([*words, "--simulate_azimuth_deg", "75", "--stops", "240", "--settle", "1"]) == 0
    found = json.loads(capsys.readouterr().out)
    print(f"\nreal noise: {found['error_deg']:+.1f} degrees off, sigma {found['sigma_deg']:.1f}")
    assert abs(found["error_deg"]) < 3.5 * found["sigma_deg"]
    # The gyro's white noise alone sets the least sigma; drift comes on top.
    assert found["sigma_deg"] > 0.9 * found["gyros"][0]["white_noise_bound_deg"]
