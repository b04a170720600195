"""Plausibility checks: invalid input is refused in one line with a remedy, excluded data is a warning."""

import numpy as np
import pytest

from gap_runs import run_gap, write_changed_log, write_changed_model
from hubodo.gap.problem.plausibility import check_plausibility
from repetitions import first_and_more


def assert_refused(run, *expected_texts):
    """Check that a run failed with one line that contains the given words, and wrote no result."""
    assert run.code == 2, run.out
    assert run.err.count("\n") == 1
    assert "Traceback" not in run.err
    for word in expected_texts:
        assert word in run.err
    assert not (run.folder / "gap.json").exists()


@pytest.mark.parametrize(
    ("text", "replacement", "expected_texts"),
    [
        ("[inputs]", "[effects.wheel_cambr]\nangle = 0.1\n[inputs]", ("wheel_cambr", "'wheel_camber'")),
        ("[inputs]", "[effects.wheel_camber]\nangel = 0.1\n[inputs]", ("angel", "'angle'")),
        ("wheel_radius =", "wheel_radiu =", ("wheel_radiu", "'wheel_radius'")),
        ('"reference.speed"', '"reference.sped"', ("reference.sped", "'reference.speed'")),
        ('"reference.speed"', '"wheels.gz"', ("'wheels.gz'", "it has left, right, reference")),
        ("nodes.left", "nodes.front", ("gz",)),
    ],
)
def test_a_misspelt_model_file_is_refused_with_the_nearest_name(
    clean_log, tmp_path, text, replacement, expected_texts
):
    if "front" in replacement:
        # An unknown node is only a warning as long as the log has another node.
        model = write_changed_model(clean_log, tmp_path / "model.toml", (text, replacement))
        run = run_gap(tmp_path / "out", model, clean_log)
        assert run.code == 0
        assert "front: not in the log" in run.result["warnings"]
        return
    assert_refused(
        run_gap(
            tmp_path / "out",
            write_changed_model(clean_log, tmp_path / "model.toml", (text, replacement)),
            clean_log,
        ),
        *expected_texts,
    )


def test_invalid_arguments_are_refused(clean_log, tmp_path):
    model, existing_file = clean_log / "model.toml", tmp_path / "file"
    existing_file.write_text("", "utf-8")
    assert_refused(run_gap(tmp_path / "a", model, clean_log, "--reject", "gyro_bais"), "'gyro_bias'")
    assert_refused(
        run_gap(tmp_path / "b", model, clean_log, "--explain", "xyzzy"), "no such effect", "clock_skew"
    )
    options = ("--accept", "gyro_bias", "--reject", "gyro_bias")
    assert_refused(run_gap(tmp_path / "c", model, clean_log, *options), "both name gyro_bias")
    assert_refused(run_gap(existing_file, model, clean_log), "is a file")
    assert_refused(run_gap(clean_log, model, clean_log), "is the input model")
    assert_refused(run_gap(tmp_path / "d", model, tmp_path / "nowhere"), "nowhere")
    assert model.read_text("utf-8").startswith("[vehicle]")


def test_a_log_without_the_inputs_of_the_model_is_refused(clean_log, tmp_path):
    folder = tmp_path / "log"
    folder.mkdir()
    for name in ("left.csv", "right.csv"):
        (folder / name).write_bytes((clean_log / name).read_bytes())
    assert_refused(
        run_gap(tmp_path / "out", clean_log / "model.toml", folder), "'reference.speed'", "[inputs]"
    )


def truncate(columns):
    return {name: values[columns["t"] < 15.0] for name, values in columns.items()}


def test_a_log_below_twenty_seconds_is_refused(clean_log, tmp_path):
    log = write_changed_log(clean_log, tmp_path / "log", lambda name, columns: truncate(columns), truncate)
    assert_refused(run_gap(tmp_path / "out", clean_log / "model.toml", log), "overlap for 15.0 s", "20 s")


def freeze_channels(columns, *names):
    return {
        name: np.full_like(values, values[0]) if name in names else values for name, values in columns.items()
    }


def test_constant_channels_are_excluded_with_a_warning(clean_log, tmp_path):
    channels = ("gx", "gy", "gz", "ax", "ay", "az")
    frozen_log = write_changed_log(
        clean_log, tmp_path / "dead", lambda name, columns: freeze_channels(columns, *channels)
    )
    assert_refused(
        run_gap(tmp_path / "o", clean_log / "model.toml", frozen_log), "no channel of any node changes"
    )
    partly_frozen_log = write_changed_log(
        clean_log,
        tmp_path / "one",
        lambda name, columns: (
            freeze_channels(columns, "gx") if name == "left" else freeze_channels(columns, "ax")
        ),
    )
    run = run_gap(tmp_path / "out", clean_log / "model.toml", partly_frozen_log)
    assert (run.code, run.result["verdict"]) == (0, "no_gap")
    assert "left: gx never change; left out" in run.result["warnings"]
    assert any(line.startswith("right: without ax and ay") for line in run.result["warnings"])


def scale_channels(factor, prefix):
    def scaled(name, columns):
        return {key: values * factor if key[0] == prefix else values for key, values in columns.items()}

    return scaled


def test_wrong_units_signs_and_sides_are_refused(clean_log, tmp_path):
    model = clean_log / "model.toml"
    log_in_degrees = write_changed_log(clean_log, tmp_path / "degrees", scale_channels(57.29578, "g"))
    assert_refused(run_gap(tmp_path / "a", model, log_in_degrees), "degrees per second")
    log_in_g = write_changed_log(clean_log, tmp_path / "in_g", scale_channels(1.0 / 9.80665, "a"))
    assert_refused(run_gap(tmp_path / "b", model, log_in_g), "in g")
    wrong_facing = 'facing = "left"', 'facing = "right"'
    assert_refused(
        run_gap(tmp_path / "c", write_changed_model(clean_log, tmp_path / "t.toml", wrong_facing), clean_log),
        "facing =",
    )
    swapped_sides = [('side = "left"', 'side = "x"'), ('side = "right"', 'side = "left"'), ('"x"', '"right"')]
    assert_refused(
        run_gap(
            tmp_path / "d", write_changed_model(clean_log, tmp_path / "s.toml", *swapped_sides), clean_log
        ),
        "sides",
    )
    log_at_standstill = write_changed_log(clean_log, tmp_path / "still", reference=slow_down)
    assert_refused(run_gap(tmp_path / "e", model, log_at_standstill), "speed input is 0")
    reversed_log = write_changed_log(clean_log, tmp_path / "backwards", reference=reverse_in_time)
    assert_refused(run_gap(tmp_path / "f", model, reversed_log), "is unrelated to the speed input")


def slow_down(columns):
    return {**columns, "speed": 1e-3 * columns["speed"], "yaw_rate": 1e-3 * columns["yaw_rate"]}


def reverse_in_time(columns):
    """Return a reference of another drive: the yaw rate reversed in time, and a sine as speed."""
    return {**columns, "speed": np.sin(2.0 * columns["t"]), "yaw_rate": columns["yaw_rate"][::-1]}


@pytest.mark.parametrize("factor", first_and_more(10.0, 0.1))
def test_wrongly_declared_noise_is_reported_with_its_estimate(clean_log, tmp_path, factor):
    model_text = (clean_log / "model.toml").read_text("utf-8")
    declared = [line for line in model_text.splitlines() if "gyro_noise" in line or "accel_noise" in line]
    swaps = [(line, f"{line.split('=')[0]}= {float(line.split('=')[1]) * factor:.6g}") for line in declared]
    run = run_gap(
        tmp_path / "out", write_changed_model(clean_log, tmp_path / "model.toml", *swaps), clean_log
    )
    assert run.code == 0, run.err
    assert run.names == []
    note = next(line for line in run.out.splitlines() if "[imu] gyro_noise" in line)
    assert ("smaller" if factor > 1.0 else "larger") in note
    estimate = float(note.split("about ")[1].split()[0])
    assert estimate == pytest.approx(float(declared[0].split("=")[1]), rel=0.1)


def test_a_drive_with_turns_and_stops_is_plausible_and_shows_all_but_the_temperature(problem):
    lines = check_plausibility(problem.nodes, problem.inputs, problem.speed_sources, "log")
    assert all("temperature" in line for line in lines)
