"""`hubodo north` from a CSV folder to the JSON that other programs read."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

import wanted
from generators.north_table import Sensor, carousel, maytag
from hubodo.cli import main
from hubodo.log.csv_folder import read_folder
from hubodo.log.csv_table import write_table
from hubodo.log.recording_writer import write_recording
from hubodo.recording import NODE_COLUMNS, Recording, Table
from hubodo.sensors.north.axis_record import AxisRecord
from hubodo.sensors.north.circular import wrap_angle
from hubodo.sensors.north.north_estimate import find_north
from hubodo.sensors.north.stops import TableMotion

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
    status, result = north(capsys, folder(tmp_path / "log", run), "--axis", "x", "--method", method)
    assert status == 0, result
    truth = {"maytag4": 200.0, "maytag": 60.0, "carousel": 310.0, "east": 30.0}[method]
    off = (result["azimuth_deg"] - truth + 180) % 360 - 180
    assert abs(off) < 4 * result["sigma_deg"] < 40
    assert result["rate"] and all(abs(r) < 1e-3 for r in result["rate"])
    assert 350 < result["duration"] < 460
    gyro = result["gyros"][0]
    assert gyro["white_noise_bound_deg"] <= gyro["sigma_deg"] * 1.3
    if method.startswith("maytag"):
        assert set(gyro["filters"]) >= {"nearest", "swanson_schlamminger", "sliding_average"}
    if method == "maytag":
        assert len(gyro["candidates_deg"]) == 2 and "two azimuths" in result["warnings"][0]


def test_two_axes_of_a_node_are_fused_with_y_a_quarter_turn_on(tmp_path, capsys):
    azimuth = 120.0
    run = stops(5, azimuth)
    other = stops(6, azimuth)
    # The y axis points a quarter turn anticlockwise: x would measure the same with table zero 90 degrees
    # less.
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
        (["--method", "carousel"], "turns; a carousel needs at least 2"),
        (["--latitude_deg", "95"], "out of range"),
        (["--latitude_deg", "89.9"], "too close to the pole"),
        (["--node", "left"], "no node 'left'"),
        (["--simulate_azimuth_deg", "10", "--stops", "2"], "give at least 4 stops"),
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
    status, result = north(capsys, folder(tmp_path / "log", run, table=False), "--method", "maytag4")
    assert status == 0 and any("angles are derived from the gyro" in text for text in result["warnings"])
    assert result["gyros"][0]["stops"]["count"] == 12
    assert abs(result["azimuth_deg"] - azimuth) < 4 * result["sigma_deg"]
    assert result["sigma_deg"] >= 0.9 * known["sigma_deg"]
    assert result["gyros"][0]["angle_sigma_deg"] > 0.1 > known["gyros"][0]["angle_sigma_deg"]
    # The same result if table.csv is to be ignored, and exact angles if the table has steps.
    status, stepped = north(capsys, with_table, "--method", "maytag4", "--find-stops", "--step-deg", "90")
    assert status == 0 and stepped["gyros"][0]["angle_sigma_deg"] == 0.0


def test_the_whole_calibration_is_applied_and_reported(tmp_path, capsys):
    """A log with errors of bias, scale, temperature, age and force gives the same result as one without."""
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
    status, result = north(capsys, path, "--method", "maytag4", "--calibration", str(calibration))
    assert status == 0, result
    assert result["azimuth_deg"] == pytest.approx(pure["azimuth_deg"], abs=1e-6)
    assert set(result["calibration"]["imu"]["applied"]) == set(lines)
    assert any("not say when the node was switched on" in text for text in result["warnings"])
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


def test_page_and_figure_show_estimates_fit_and_what_to_do(tmp_path, capsys):
    path = folder(tmp_path / "log", stops(8, 130.0, count=12), table=False)
    page, figure = tmp_path / "north.html", tmp_path / "north.png"
    words = ["--method", "maytag4", "--report", str(page), "--figure", str(figure)]
    status, result = north(capsys, path, *words)
    assert status == 0, result
    text = page.read_text("utf-8")
    assert len(text) < 1_000_000 and not re.search(r"(src|href)=.http", text)
    for text_part in (
        f"{result['azimuth_deg']:.1f}° ± {result['sigma_deg']:.1f}° (1σ)",
        "maximum likelihood",
        "nearest",
        "<svg",
        "What to do",
        "stops of",
    ):
        assert text_part in text
    assert figure.read_bytes()[:4] == b"\x89PNG"
    # One figure per gyro; the residuals are noise.
    left = float(text.split("Variance of the whitened residuals: ")[1].split(" ")[0])
    assert 0.6 < left < 1.5


def test_a_plan_says_which_stops_reach_a_sigma_and_they_do(tmp_path, capsys):
    """Plan from a stationary record, and from the output of hubodo allan --json for it."""
    rng = np.random.default_rng(21)
    count = 36_000
    sensor = Sensor(0.05, 0.5, 1.0)
    columns = {"t": np.arange(count) * DT}
    for name in ("gx", "gy", "gz"):
        columns[name] = sensor.error(count, DT, rng)
    columns |= {"ax": rng.normal(0, 0.01, count), "ay": rng.normal(0, 0.01, count)}
    log = tmp_path / "log.mcap"
    write_recording(Recording({"imu": Table({**columns, "az": 9.81 + rng.normal(0, 0.01, count)})}), log)
    status, plan = north(capsys, log, "--plan", "--sigma-deg", "2")
    assert status == 0, plan
    assert plan["drift"]["N"] == pytest.approx(np.radians(sensor.n) / 60, rel=0.03)
    assert main(["allan", str(log), "--channel", "gx", "--json"]) == 0
    (tmp_path / "gx.json").write_text(capsys.readouterr().out)
    words = ["north", "--plan", "--allan", str(tmp_path / "gx.json"), "--latitude-deg", str(LATITUDE_DEG)]
    assert main([*words, "--sigma-deg", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["wanted"] == plan["wanted"]
    wanted = plan["wanted"]
    z = []
    for seed in range(6):
        rng = np.random.default_rng(100 + seed)
        stop, number = wanted["stop"], wanted["stops"]
        error = sensor.error(int(number * (stop + 2) / DT) + 10, DT, rng)
        angles = list(np.resize(POINTS, number))
        latitude = np.radians(LATITUDE_DEG)
        run = maytag(error, DT, 1.0 + seed, latitude, angles, stop, 2.0)
        motion = TableMotion(run.table_t, run.table_angle, run.table_moving)
        result = find_north([AxisRecord(run.t, run.rate, motion)], latitude, "maytag4", settle=0.1)
        z.append(np.degrees(float(wrap_angle(result.azimuth - 1.0 - seed))) / wanted["sigma_deg"])
    print(np.round(z, 2))
    # The rms of 6 values scatters by 30 %.
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.6


def test_noise_that_is_given_is_widened_where_the_record_has_more(tmp_path, capsys):
    path = folder(tmp_path / "log", stops(8, 130.0, count=12))
    allan = {"coefficients": {name: {"value": value} for name, value in (("N", 1e-7), ("B", 0), ("K", 0))}}
    (tmp_path / "gx.json").write_text(json.dumps(allan))
    status, result = north(capsys, path, "--method", "maytag4", "--allan", str(tmp_path / "gx.json"))
    assert status == 0 and any("times as noisy as given by --allan" in text for text in result["warnings"])
    assert abs(result["azimuth_deg"] - 130.0) < 4 * result["sigma_deg"]


def test_a_real_gyro_on_a_simulated_table_finds_north_within_its_sigma(tmp_path, capsys):
    """The first 25 minutes of a record of a stationary ADIS16405."""
    rows = np.loadtxt(wanted.recording("static") / "node.csv.gz", delimiter=",", skiprows=1, max_rows=150_000)
    path = tmp_path / "static.mcap"
    write_recording(Recording({"node": Table(dict(zip(NODE_COLUMNS, rows.T, strict=True)))}), path)
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
    assert main([*words, "--simulate_azimuth_deg", "75", "--stops", "36", "--settle", "1"]) == 0
    result = json.loads(capsys.readouterr().out)
    print(f"\nreal noise: {result['error_deg']:+.1f} degrees off, sigma {result['sigma_deg']:.1f}")
    assert abs(result["error_deg"]) < 3.5 * result["sigma_deg"]
    # The white noise of the gyro alone is the lower bound of sigma; drift adds to it.
    assert result["sigma_deg"] > 0.9 * result["gyros"][0]["white_noise_bound_deg"]
