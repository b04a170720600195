"""`hubodo allan` and `hubodo warmup`: JSON for programs, files for people, refusals in one line."""

import json
import sys
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from generators import start_gyro as start
from generators.noise import gyro_noise
from hubodo.calibration.file import read_calibration
from hubodo.cli import main
from hubodo.log.recording_writer import write_recording
from hubodo.recording import Recording, Table
from in_process import hubodo

DEG = np.pi / 180.0
SEED = 8


def write_log(path: Path, gz, dt, **more) -> Path:
    rng = np.random.default_rng(SEED)
    count = len(gz)
    columns = {
        "t": np.arange(count) * dt,
        "gx": rng.normal(0, 1e-3, count),
        "gy": rng.normal(0, 1e-3, count),
        "gz": gz,
    }
    columns |= {"ax": rng.normal(0, 0.02, count), "ay": rng.normal(0, 0.02, count)}
    columns |= {"az": 9.8 + rng.normal(0, 0.02, count), **more}
    path = path.with_suffix(".mcap")
    write_recording(Recording({"left": Table(columns)}), path)
    return path


@pytest.fixture(scope="module")
def static_log(tmp_path_factory) -> Path:
    noise = gyro_noise(1 << 15, 0.01, np.random.default_rng(SEED), n=1e-3, b=3e-3, k=3e-3)
    return write_log(tmp_path_factory.mktemp("allan") / "rest", noise, 0.01)


@pytest.fixture(scope="module")
def cold_start_log(tmp_path_factory) -> Path:
    _, output = start.overnight(0.5, 4 * 3600.0, np.random.default_rng(SEED))
    return write_log(tmp_path_factory.mktemp("warmup") / "cold", output * DEG, 0.5)


def run(*arguments) -> dict:
    done = hubodo(*arguments, "--json")
    assert done.code == 0, done.err
    return json.loads(done.out)


@dataclass(frozen=True)
class WarmupRun:
    """A run of `hubodo warmup` with all outputs: its JSON result and its files."""

    result: dict
    calibration: Path
    page: Path
    figure: Path


@pytest.fixture(scope="module")
def warmup_run(cold_start_log) -> WarmupRun:
    files = (
        cold_start_log.parent / "c.toml",
        cold_start_log.parent / "w.html",
        cold_start_log.parent / "w.svg",
    )
    files[0].write_text("[nodes.left.effects.gyro_bias]\nx = { value = 0.001, sigma = 1e-5 }\n")
    options = zip(("-o", "--report", "--figure"), files, strict=True)
    axis = ("--node", "left", "--channel", "gz", "--at", 0, "--at", 36000)
    return WarmupRun(run("warmup", cold_start_log, *axis, *chain(*options)), *files)


def test_allan_prints_json(static_log):
    result = run("allan", static_log, "--node", "left", "--channel", "gz")
    assert len(result["tau"]) == len(result["adev"]) == len(result["sigma"]) == 15
    assert set(result["coefficients"]) == {"N", "B", "K", "Q", "R"}
    white = result["coefficients"]["N"]
    assert white["value"] == pytest.approx(1e-3, rel=0.1)
    assert white["sigma"] < 1e-4
    assert white["unit"] == "rad/√s"
    assert white["value_deg_per_sqrt_h"] == pytest.approx(white["value"] * 180 / np.pi * 60)
    ramp = result["coefficients"]["R"]
    assert ramp["value"] is None
    assert ramp["reason"]
    assert result["maytag"]["stop"] > 0


def test_without_matplotlib_the_page_is_written_and_one_line_names_the_package(
    static_log, tmp_path, capsys, monkeypatch
):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    png, page = tmp_path / "gz.png", tmp_path / "gz.html"
    assert main(["allan", str(static_log), "--figure", str(png), "--report", str(page)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "pip install 'matplotlib" in line and "defect" not in line
    text = page.read_text("utf-8")
    assert "angle random walk" in text and "Allan deviation of left gz" in text and not png.exists()


def test_the_suffix_selects_the_format_of_a_figure_and_unknown_ones_are_refused(static_log, tmp_path, capsys):
    """PNG is one of the formats; another test writes SVG."""
    assert main(["allan", str(static_log), "--figure", str(tmp_path / "gz.png")]) == 0
    assert "angle random walk" in capsys.readouterr().out
    assert (tmp_path / "gz.png").read_bytes().startswith(b"\x89PNG")
    assert main(["allan", str(static_log), "--figure", str(tmp_path / "gz.gif")]) == 2
    assert ".svg" in capsys.readouterr().err


def test_accelerometer_channels_have_their_own_names(static_log):
    result = run("allan", static_log, "--channel", "ax")
    assert result["coefficients"]["N"]["unit"] == "m/s/√s"
    assert result["coefficients"]["N"]["value"] == pytest.approx(0.02 * 0.1, rel=0.05)


def test_warmup_prints_json(warmup_run):
    result = warmup_run.result
    for name, true_value in (("c1", start.C1 * DEG), ("c2", start.C2 * DEG), ("time_constant", start.T)):
        assert abs(result[name]["value"] - true_value) < 4 * result[name]["sigma"], name
    assert result["white"] is True
    assert result["whiteness"]["ljung_box"]["p_value"] > 0.005
    assert result["next_model"] is None


def test_warmup_adds_the_axis_to_the_calibration_file_and_keeps_other_entries(warmup_run):
    result = warmup_run.result
    effects = read_calibration(warmup_run.calibration).nodes["left"].effects
    assert effects["gyro_warmup"].parameters["z"].value == result["c1"]["value"]
    assert effects["gyro_warmup"].parameters["time_constant"].sigma == result["time_constant"]["sigma"]
    assert effects["gyro_bias"].value("z") == result["c2"]["value"]
    assert effects["gyro_bias"].value("x") == 0.001
    assert len(effects["gyro_warmup"].source_sha256) == 64
    assert "Whiteness" in warmup_run.page.read_text("utf-8")


def test_warmup_writes_a_figure_and_a_small_page_and_forecasts_requested_ages(
    warmup_run, cold_start_log, capsys
):
    result = warmup_run.result
    assert [row["age"] for row in result["prediction"]] == [0.0, 36000.0]
    last = result["prediction"][1]
    assert abs(last["bias"] - start.bias(36000.0) * DEG) < 3 * last["sigma"]
    assert result["accepted"] == "exponential" and result["bias_filter"]["chosen"] in (
        "mean",
        "Kalman",
        "RLS",
    )
    text = warmup_run.page.read_text("utf-8")
    assert len(text) < 1_000_000 and "What to do" in text and "residual" in text and "<svg" in text
    assert warmup_run.figure.read_text("utf-8").lstrip().startswith("<?xml")
    assert main(["warmup", str(cold_start_log), "--at", "-1"]) == 2
    assert "--at: -1: write a number from 0 on" in capsys.readouterr().err


def test_axes_share_a_time_constant_and_a_simpler_model_replaces_the_old_one(cold_start_log, tmp_path):
    out = tmp_path / "c.toml"
    out.write_text(
        "[nodes.left.effects.gyro_temperature]\nz = { value = 0.001, sigma = 1e-5 }\n"
        "[nodes.left.effects.gyro_warmup]\nx = { value = 0.001, sigma = 1e-5 }\n"
        "z = { value = 0.001, sigma = 1e-5 }\nz_second = { value = 0.1, sigma = 1e-5 }\n"
        "time_constant = { value = 3800.0, sigma = 100.0 }\n"
        "time_constant_second = { value = 100.0, sigma = 1.0 }\n"
    )
    result = run("warmup", cold_start_log, "-o", out)
    effects = read_calibration(out).nodes["left"].effects
    assert set(effects) == {"gyro_warmup", "gyro_bias"}
    assert set(effects["gyro_warmup"].parameters) == {"x", "z", "time_constant"}
    assert effects["gyro_warmup"].value("z") == result["c1"]["value"]
    constant = effects["gyro_warmup"].parameters["time_constant"]
    assert 0.0 < constant.sigma < min(100.0, result["time_constant"]["sigma"])


def test_without_a_warm_up_no_calibration_file_is_written(static_log, tmp_path, capsys):
    out = tmp_path / "c.toml"
    assert main(["warmup", str(static_log), "-o", str(out), "--channel", "gx"]) == 2
    line = capsys.readouterr().err.strip()
    assert "nothing to write to a calibration file" in line
    assert "\n" not in line
    assert not out.exists()


def test_records_that_are_not_stationary_or_not_in_si_are_refused_in_one_line(tmp_path, static_log, capsys):
    noise = gyro_noise(6000, 0.01, np.random.default_rng(SEED), n=1e-3)
    rotated = noise.copy()
    rotated[3000:3300] += 1.0
    temperature_step = {
        "temperature": 25
        + 6.0 * (np.arange(20_000) > 10_000)
        + np.random.default_rng(1).normal(0, 0.1, 20_000)
    }
    long_noise = gyro_noise(20_000, 0.05, np.random.default_rng(SEED), n=1e-3)
    cases = [
        ("allan", write_log(tmp_path / "deg", noise / DEG, 0.01), "looks like deg/s"),
        ("warmup", write_log(tmp_path / "turned", rotated, 0.01), "the sensor was moved between"),
        ("allan", write_log(tmp_path / "short", noise[:100], 0.01), "too few for an Allan deviation"),
        ("allan", write_log(tmp_path / "stuck", np.full(6000, 0.01), 0.01), "the sensor is stuck"),
        (
            "warmup",
            write_log(tmp_path / "room", long_noise, 0.05, **temperature_step),
            "the temperature steps by +6",
        ),
        ("warmup", write_log(tmp_path / "brief", noise[:3000], 0.01), "too short for a warm-up"),
    ]
    for verb, log, message in cases:
        assert main([verb, str(log)]) == 2, message
        line = capsys.readouterr().err.strip()
        assert message in line
        assert "\n" not in line
    assert main(["allan", str(static_log), "--node", "frame"]) == 2
    assert "give --node with one of: left" in capsys.readouterr().err


def test_a_temperature_step_invalidates_only_the_slow_noise_terms(tmp_path):
    temperature_step = {
        "temperature": 25
        + 6.0 * (np.arange(20_000) > 10_000)
        + np.random.default_rng(1).normal(0, 0.1, 20_000)
    }
    log = write_log(
        tmp_path / "room",
        gyro_noise(20_000, 0.05, np.random.default_rng(SEED), n=1e-3),
        0.05,
        **temperature_step,
    )
    result = run("allan", log)
    assert result["coefficients"]["N"]["value"] == pytest.approx(1e-3, rel=0.1)
    assert "the temperature steps" in result["coefficients"]["K"]["reason"]
