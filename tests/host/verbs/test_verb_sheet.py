"""`hubodo sheet`: parts are those of their own verbs, the print-out has two sides, odd input is refused."""

import base64
import json
import re

import numpy as np
import pytest

import hubodo as hubodo_package
from browser_page import Page
from generators.noise import gyro_noise
from generators.poses import Errors, carry
from hubodo.calibration.file import read_calibration
from hubodo.log.recording_writer import write_recording
from hubodo.recording import NODE_COLUMNS, Recording, Table
from hubodo.report.sensor_sheet import SensorSheet
from hubodo.sensors.imu.pose_plan import noise_of_accelerometers, plan_poses
from in_process import hubodo

SEED = 5
UPRIGHT = np.array([0.0, 0.0, 9.81])
COLD_BIAS, TIME_CONSTANT = 4e-3, 300.0


def write_log(path, t, gyro, accel):
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    columns = dict(zip(names, np.hstack([gyro, accel]).T, strict=True))
    write_recording(Recording({"left": Table({"t": t, **columns})}), path)
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Logs of one sensor: at standstill, from power-on, in poses."""
    folder, rng = tmp_path_factory.mktemp("sheet"), np.random.default_rng(SEED)
    count, dt = 6000, 0.05
    gyro = np.column_stack([gyro_noise(count, dt, rng, n=1e-3, b=1e-4, k=1e-5) for _ in range(3)])
    accel = np.column_stack([gyro_noise(count, dt, rng, n=2e-3, b=2e-4, k=1e-5) for _ in range(3)])
    still = write_log(folder / "still.mcap", np.arange(count) * dt, gyro, accel + UPRIGHT)
    t = np.arange(0.0, 1800.0, 0.5)
    drift = COLD_BIAS * (1.0 - np.exp(-t / TIME_CONSTANT))
    gyro = np.column_stack([np.zeros_like(t), np.zeros_like(t), drift]) + rng.normal(0.0, 3e-4, (len(t), 3))
    cold = write_log(folder / "cold.mcap", t, gyro, rng.normal(0.0, 0.02, (len(t), 3)) + UPRIGHT)
    carried = carry(rng, Errors(b=(0.01, -0.02, 0.0)), Errors(b=(0.1, -0.05, 0.2)))
    poses = write_log(folder / "poses.mcap", carried.t, carried.gyro, carried.accel)
    return still, cold, poses


@pytest.fixture(scope="module")
def sheet(logs, tmp_path_factory):
    still, cold, poses = logs
    out = tmp_path_factory.mktemp("sheets") / "left"
    done = hubodo("sheet", "--still", still, "--warmup", cold, "--poses", poses, "-o", out, "--json")
    assert done.code == 0, done.err
    return out, json.loads(done.out)


def test_noise_warm_up_and_calibration_are_those_of_their_own_verbs(logs, sheet, tmp_path):
    still, cold, poses = logs
    out, result = sheet
    for channel in ("gx", "az"):
        alone = json.loads(hubodo("allan", still, "--channel", channel, "--json").out)
        assert result["noise"][channel]["coefficients"] == alone["coefficients"]
    assert hubodo("allan", still, "--kalibr", tmp_path / "imu.yaml").code == 0
    assert (out / "imu.yaml").read_text() == (tmp_path / "imu.yaml").read_text()
    path = tmp_path / "calibration.toml"
    assert hubodo("warmup", cold, "--channel", "gz", "-o", path).code == 0
    assert hubodo("calibrate", "imu", poses, "--node", "left", "-o", path).code == 0
    assert read_calibration(out / "calibration.toml").nodes == read_calibration(path).nodes


def test_the_warm_up_is_that_of_the_record(sheet):
    _, result = sheet
    parameters = (
        read_calibration(sheet[0] / "calibration.toml").nodes["left"].effects["gyro_warmup"].parameters
    )
    change = parameters["z"]
    print(change, COLD_BIAS)
    assert abs(abs(change.value) - COLD_BIAS) < 4.0 * change.sigma < COLD_BIAS
    assert set(result["warmup"]) == {"gx", "gy", "gz"}


def test_printed_it_has_two_sides(sheet, tmp_path):
    out, _ = sheet
    with Page(f"file://{out}/", tmp_path / "profile") as page:
        page.open("sheet.html")
        page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        printed = page.driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    pages = re.findall(rb"/Type\s*/Page\b(?!s)", base64.b64decode(printed["data"]))
    assert len(pages) == 2


def test_a_part_without_a_record_is_left_out(logs, tmp_path):
    _, _, poses = logs
    out = tmp_path / "short"
    done = hubodo("sheet", "--poses", poses, "-o", out, "--json")
    assert done.code == 0, done.err
    files = [name.rpartition("/")[2] for name in json.loads(done.out)["files"]]
    assert files == ["sheet.html", "calibration.toml"] == [path.name for path in sorted(out.iterdir())][::-1]


def test_without_a_record_and_with_two_sensors_it_is_refused(tmp_path):
    assert "at least one of --still, --warmup and --poses" in hubodo("sheet", "-o", tmp_path / "x").err
    t, rows = np.arange(0.0, 60.0, 0.02), np.zeros((3000, 3))
    sensors = []
    for serial in ("aa", "bb"):
        columns = dict(zip(NODE_COLUMNS, (t, *rows.T, *(rows + UPRIGHT).T), strict=True))
        sensors.append(tmp_path / f"{serial}.mcap")
        write_recording(Recording({"left": Table(columns)}, metadata={"serial.left": serial}), sensors[-1])
    done = hubodo("sheet", "--still", sensors[0], "--poses", sensors[1], "-o", tmp_path / "x")
    assert done.code == 2 and "serial bb, the log before of aa" in done.err and not (tmp_path / "x").exists()
    done = hubodo("sheet", "--poses", sensors[0], "-o", tmp_path / "x")
    assert done.code != 0 and "aa.mcap: " in done.err and not (tmp_path / "x").exists()


def test_force_replaces_the_files_of_a_sheet_and_no_others(sheet, logs, tmp_path):
    out, _ = sheet
    words = ("sheet", "--poses", logs[2], "-o", out)
    assert "exists already" in hubodo(*words).err
    (out / "mine.txt").write_text("x")
    assert "mine.txt, which hubodo did not write" in hubodo(*words, "--force").err
    (out / "mine.txt").unlink()
    assert hubodo(*words, "--force").code == 0 and not (out / "imu.yaml").exists()


def test_a_sheet_takes_means_of_poses(tmp_path):
    up = np.random.default_rng(8).normal(size=(16, 3))
    accel = 9.80665 * up / np.linalg.norm(up, axis=1)[:, None] + [0.1, -0.2, 0.05]
    table = tmp_path / "means.csv"
    np.savetxt(table, accel, delimiter=",", header="ax,ay,az", comments="", fmt="%.4f")
    done = hubodo("sheet", "--poses", table, "--means", "--node", "left", "-o", tmp_path / "sheet")
    assert done.code == 0, done.err
    page = (tmp_path / "sheet" / "sheet.html").read_text("utf-8")
    assert "means of poses" in page and "accel_bias" in page
    stored = read_calibration(tmp_path / "sheet" / "calibration.toml").nodes["left"]
    assert abs(stored.effects["accel_bias"].parameters["y"].value + 0.2) < 1e-3


def test_a_sheet_of_accelerometers_without_poses_says_how_many_to_set(logs):
    noise = [hubodo_package.open(logs[0]).allan(channel="ax")]
    page = SensorSheet("left", [], [], noise).html()
    assert f"With this noise {plan_poses(noise_of_accelerometers(noise), 0.005, 5.0).summary()}." in page
