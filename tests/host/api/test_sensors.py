"""Sensor analyses from Python equal those of the verbs, and are refused by errors of hubodo in one line."""

import json

import numpy as np
import pandas as pd
import pytest

import hubodo
from generators.rate_table import Axis, turn_table
from generators.table_folders import write_record
from generators.table_record import DEG_H, Programme
from hubodo.calibration.file import CalibratedEffect, Quantity
from in_process import hubodo as run
from vehicles import DRIVE_MODEL, LOW_INPUT_NOISE


def verb_result(*words):
    done = run(*words, "--json")
    assert done.code == 0, done.err
    return json.loads(done.out)


def as_printed(result):
    return json.loads(json.dumps(result.as_json()))


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sensors")
    model = folder / "model.toml"
    model.write_text(DRIVE_MODEL + LOW_INPUT_NOISE + "[effects.accel_bias]\nx = 0.3\ny = -0.2\nz = 0.3\n")
    for drive, options in (
        ("poses", ("--duration", 80, "--rate", 50)),
        ("random", ("--duration", 24, "--rate", 50)),
    ):
        words = ("simulate", model, "--drive", drive, *options, "--seed", 3, "-o", folder / f"{drive}.mcap")
        assert run(*words).code == 0
    return folder


def test_an_imu_calibration_equals_that_of_the_verb(logs, tmp_path):
    result = hubodo.open(logs / "poses.mcap").calibrate_imu("left", gravity=9.81)
    words = ("calibrate", "imu", logs / "poses.mcap", "--node", "left", "--gravity", 9.81)
    printed = verb_result(*words, "-o", tmp_path / "c.toml")
    assert {**printed, "output": ""} == as_printed(result)
    assert {"accel_bias", "gyro_bias"} <= set(result.effect_parameters())
    assert repr(result).startswith("ImuCalibration(left: ") and "<table" in result._repr_html_()


def test_filters_equal_those_of_the_verb_but_for_the_run_time(logs):
    path = logs / "random.mcap"
    result = as_printed(hubodo.open(path).filters("left", reference="reference.speed"))
    printed = verb_result("filters", path, "--node", "left", "--reference", "reference.speed")
    for it in (*result["filters"], *printed["filters"]):
        assert it.pop("run_time_us") > 0.0
    assert {**printed, "log": None} == result
    assert result["reference"]["scale_unit"] == "rad/m"


def test_a_heading_equals_that_of_the_verb(tmp_path):
    """Ten seconds at rest, then a turn of 90 degrees; the bias is that of the rest."""
    rng = np.random.default_rng(4)
    t = np.arange(3000) * 0.01
    rate = np.where((t > 15.0) & (t < 20.0), np.pi / 10.0, 0.0)
    gyro = rng.normal(0.01, 1e-3, (3000, 3)) + np.outer(rate, [0.0, 0.0, 1.0])
    accel = rng.normal([0.0, 0.0, 9.81], 0.02, (3000, 3))
    path = hubodo.from_arrays(gyro, accel, t=t).save(tmp_path / "turn.mcap")
    result = hubodo.open(path).heading(standstills=[(0.0, 10.0)], scale_sigma=0.02)
    assert verb_result("heading", path, "--rest", 0, 10, "--scale-sigma", 0.02) == as_printed(result)
    assert result.track.heading[-1] == pytest.approx(np.pi / 2.0, abs=0.01)
    assert repr(result).startswith("HeadingResult(imu z: turned by +") and "<table" in result._repr_html_()


def test_a_rate_calibration_equals_that_of_the_verb(tmp_path):
    """Nine rates of ten seconds; with a list of rates the plateaus are those of the gyro."""
    axis = Axis(bias=0.01, scale=0.004)
    t, gyro, table = turn_table(np.random.default_rng(2), axis, seconds=10.0, rounds=1)
    columns = np.column_stack([np.zeros_like(t), np.zeros_like(t), gyro])
    accel = np.tile([0.0, 0.0, 9.81], (len(t), 1))
    path = hubodo.from_arrays(columns, accel, t=t).save(tmp_path / "table.mcap")
    rates = tmp_path / "rates.csv"
    lines = [f"{at:.6f},{np.degrees(rate):.6f}" for at, rate in table]
    rates.write_text("t,rate_deg_s\n" + "\n".join(lines) + "\n")
    log = hubodo.open(path)
    result = log.calibrate_rate(table=rates, latitude_deg=45.0, full_scale_deg_s=250.0)
    words = ("calibrate", "rate", path, "--table", rates, "--latitude-deg", 45, "--full-scale-deg-s", 250)
    printed = verb_result(*words, "-o", tmp_path / "c.toml")
    assert {**printed, "output": ""} == as_printed(result)
    assert repr(result).startswith("RateCalibration(imu gz: 17 plateaus") and "<table" in result._repr_html_()
    listed = log.calibrate_rate(rates_deg_s=np.degrees(table[:, 1]))
    assert listed.fit.scale_error.value == pytest.approx(0.004, abs=4 * listed.fit.scale_error.sigma)
    for wrong, message in (
        ({}, "either table or rates_deg_s"),
        ({"rates_deg_s": [0.0], "axis": "w"}, "axis 'w'"),
        ({"rates_deg_s": [0.0], "settle": -1.0}, "settle = -1.0"),
        ({"rates_deg_s": [0.0], "latitude_deg": 91.0}, "latitude_deg = 91.0"),
        ({"rates_deg_s": [0.0], "full_scale_deg_s": 0.0}, "full_scale_deg_s = 0.0"),
        ({"rates_deg_s": [0.0, 5.0]}, "2 rates are listed, and the gyro shows 17"),
    ):
        with pytest.raises(hubodo.HubodoError, match=message):
            log.calibrate_rate(**wrong)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda log: log.heading("left", "w"), hubodo.InputError, "axis 'w': choose from x, y, z"),
        (lambda log: log.heading("left", step=0.0), hubodo.InputError, "step = 0.0"),
        (lambda log: log.calibrate_imu("middle"), hubodo.InputError, "no node 'middle'"),
        (lambda log: log.calibrate_imu("left", gravity=1.0), hubodo.InputError, "gravity 1.0"),
        (lambda log: log.filters("left", "ax"), hubodo.InputError, "gx, gy, gz"),
        (lambda log: log.filters("left", reference="gnss"), hubodo.InputError, "--reference gnss"),
    ],
)
def test_invalid_calls_are_refused_in_one_line(call, error, message, logs):
    with pytest.raises(error, match=message) as caught:
        call(hubodo.open(logs / "random.mcap"))
    assert "\n" not in str(caught.value)


def test_north_equals_that_of_the_verb(tmp_path):
    """A tactical gyro on a table at 45 degrees latitude, with table.csv; the azimuth is 30 degrees."""
    programme = Programme([180, -90, 180, -270, 180, -90, 180], [15.0] * 8, [60.0] * 7)
    world = {"azimuth": np.radians(30.0), "latitude": np.radians(45.0), "hz": 10.0}
    noise = {"n": np.radians(0.002), "b": 0.5 * DEG_H, "k": 1e-8}
    folder = tmp_path / "table"
    write_record(folder, programme, np.random.default_rng(1), noise=noise, **world)
    log = hubodo.open(folder)
    result = log.north(latitude_deg=45.0, method="maytag4", near_deg=20.0)
    words = ("north", folder, "--latitude-deg", 45, "--method", "maytag4", "--near-deg", 20)
    assert verb_result(*words) == as_printed(result)
    assert abs(np.degrees(result.azimuth) - 30.0) < 4.0 * np.degrees(result.sigma) < 40.0
    assert isinstance(result, hubodo.NorthResult) and result.describe_azimuth(2) in repr(result)
    for options, message in (
        ({"axis": "up"}, "axis 'up': choose from x, y, z"),
        ({"method": "spin"}, "method 'spin': choose from maytag"),
        ({"scale_sigma": 2.0}, "scale_sigma = 2.0"),
        ({"latitude_deg": 95.0}, "latitude"),
    ):
        with pytest.raises(hubodo.InputError, match=message):
            log.north(**{"latitude_deg": 45.0, **options})


def test_means_of_poses_equal_those_of_the_verb_and_its_node_is_that_of_the_file(tmp_path):
    rng = np.random.default_rng(6)
    up = rng.normal(size=(16, 3))
    accel = 9.80665 * up / np.linalg.norm(up, axis=1)[:, None] + [0.1, -0.2, 0.05]
    frame = pd.DataFrame({"label": "pose", **dict(zip(("ax", "ay", "az"), accel.T, strict=True))})
    frame[["sigma_ax", "sigma_ay", "sigma_az"]] = 1e-3
    path, output = tmp_path / "means.csv", tmp_path / "c.toml"
    frame.to_csv(path, index=False)
    words = ("calibrate", "imu", path, "--means", "-o", output)
    printed = verb_result(*words)
    assert printed["node"] == "imu" and {**printed, "output": ""} == as_printed(hubodo.calibrate_means(path))
    of_frame = hubodo.calibrate_means(frame, mean_sigma={"ax": 2e-3}).effect_parameters()["accel_bias"]
    assert of_frame["x"].value == pytest.approx(0.1, abs=4 * of_frame["x"].sigma)
    assert of_frame["x"].sigma > 1.5 * printed["effects"]["accel_bias"]["x"]["sigma"]
    assert verb_result(*words[:-1], write_nodes(tmp_path / "one.toml", "left"))["node"] == "left"
    refused = run(*words[:-1], write_nodes(tmp_path / "two.toml", "left", "right"))
    assert refused.code == 2 and "give --node with the one to calibrate: left, right" in refused.err
    for options in ({"mean_sigma": {"ax": 0.0}}, {"mean_sigma": {"qx": 1.0}}, {"columns": ["ax"]}):
        with pytest.raises(hubodo.InputError):
            hubodo.calibrate_means(frame, **options)


def write_nodes(path, *names):
    bias = CalibratedEffect({"x": Quantity(0.1, 0.01)}, "by hand")
    calibration = hubodo.Calibration()
    for name in names:
        calibration = calibration.with_node(name, {"accel_bias": bias}, "")
    hubodo.write_calibration(calibration, path)
    return path


def test_a_plan_of_poses_equals_that_of_the_verb_and_takes_an_allan_deviation(tmp_path):
    plan = hubodo.plan_poses(0.002, bias_sigma=0.004)
    page = tmp_path / "plan.html"
    words = ("calibrate", "plan", "--noise-density", 0.002, "--bias-sigma", 0.004, "--report", page)
    assert verb_result(*words) == as_printed(plan)
    assert plan.summary() in page.read_text("utf-8") + repr(plan) and "1. " in page.read_text("utf-8")
    assert "<table" in plan._repr_html_()
    rng = np.random.default_rng(7)
    accel = rng.normal([0.0, 0.0, 9.81], 0.02, (6000, 3))
    still = hubodo.from_arrays(rng.normal(0.0, 1e-3, (6000, 3)), accel, rate=100.0)
    by_allan = hubodo.plan_poses(allan=still.allan(channel="ax"), bias_sigma=0.004)
    assert by_allan.noise.n == pytest.approx(0.002, rel=0.1)
    for wrong in ({}, {"noise_density": 0.0}, {"allan": still.allan(channel="gx")}):
        with pytest.raises(hubodo.InputError):
            hubodo.plan_poses(**wrong)
