"""What cannot be right is refused in one line that says what to do; what cannot be seen is said."""

import numpy as np
import pytest

from gap_runs import changed, changed_model, gap
from hubodo.gap.problem.plausibility import check_plausibility


def refused(run, *words):
    assert run.code == 2, run.out
    assert run.err.count("\n") == 1
    assert "Traceback" not in run.err
    for word in words:
        assert word in run.err
    assert not (run.folder / "gap.json").exists()


@pytest.fixture
def case(nothing):
    return nothing


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[inputs]", "[effects.wheel_cambr]\nangle = 0.1\n[inputs]", ("wheel_cambr", "'wheel_camber'")),
        ("[inputs]", "[effects.wheel_camber]\nangel = 0.1\n[inputs]", ("angel", "'angle'")),
        ("wheel_radius =", "wheel_radiu =", ("wheel_radiu", "'wheel_radius'")),
        ('"reference.speed"', '"reference.sped"', ("reference.sped", "'reference.speed'")),
        ('"reference.speed"', '"wheels.gz"', ("'wheels.gz'", "it has left, right, reference")),
        ("nodes.left", "nodes.front", ("gz",)),
    ],
)
def test_a_model_file_with_a_mistake_is_refused_with_the_nearest_word(case, tmp_path, old, new, words):
    if "front" in new:
        # Not a mistake as long as another node is there: it is said.
        model = changed_model(case, tmp_path / "model.toml", (old, new))
        made = gap(tmp_path / "out", model, case)
        assert made.code == 0
        assert "front: not in the log" in made.result["warnings"]
        return
    refused(gap(tmp_path / "out", changed_model(case, tmp_path / "model.toml", (old, new)), case), *words)


def test_arguments_that_cannot_be_are_refused(case, tmp_path):
    model, taken = case / "model.toml", tmp_path / "taken"
    taken.write_text("", "utf-8")
    refused(gap(tmp_path / "a", model, case, "--reject", "gyro_bais"), "'gyro_bias'")
    refused(gap(tmp_path / "b", model, case, "--explain", "xyzzy"), "no such effect", "clock_skew")
    both = ("--accept", "gyro_bias", "--reject", "gyro_bias")
    refused(gap(tmp_path / "c", model, case, *both), "both name gyro_bias")
    refused(gap(taken, model, case), "is a file")
    refused(gap(case, model, case), "is the input model")
    refused(gap(tmp_path / "d", model, tmp_path / "nowhere"), "nowhere")
    assert model.read_text("utf-8").startswith("[vehicle]")


def test_a_log_without_the_inputs_of_the_model_is_refused(case, tmp_path):
    folder = tmp_path / "log"
    folder.mkdir()
    for name in ("left.csv", "right.csv"):
        (folder / name).write_bytes((case / name).read_bytes())
    refused(gap(tmp_path / "out", case / "model.toml", folder), "'reference.speed'", "[inputs]")


def shorter(columns):
    return {name: values[columns["t"] < 15.0] for name, values in columns.items()}


def test_less_than_twenty_seconds_are_refused(case, tmp_path):
    log = changed(case, tmp_path / "log", lambda name, columns: shorter(columns), shorter)
    refused(gap(tmp_path / "out", case / "model.toml", log), "overlap for 15.0 s", "20 s")


def constant(columns, *names):
    return {
        name: np.full_like(values, values[0]) if name in names else values for name, values in columns.items()
    }


def test_channels_that_never_change_are_left_out_and_named(case, tmp_path):
    channels = ("gx", "gy", "gz", "ax", "ay", "az")
    dead = changed(case, tmp_path / "dead", lambda name, columns: constant(columns, *channels))
    refused(gap(tmp_path / "o", case / "model.toml", dead), "no channel of any node changes")
    one = changed(
        case,
        tmp_path / "one",
        lambda name, columns: constant(columns, "gx") if name == "left" else constant(columns, "ax"),
    )
    made = gap(tmp_path / "out", case / "model.toml", one)
    assert (made.code, made.result["verdict"]) == (0, "no_gap")
    assert "left: gx never change; left out" in made.result["warnings"]
    assert any(line.startswith("right: without ax and ay") for line in made.result["warnings"])


def times(factor, prefix):
    def scaled(name, columns):
        return {key: values * factor if key[0] == prefix else values for key, values in columns.items()}

    return scaled


def test_units_signs_and_sides_that_are_wrong_are_told_from_effects(case, tmp_path):
    model = case / "model.toml"
    degrees = changed(case, tmp_path / "degrees", times(57.29578, "g"))
    refused(gap(tmp_path / "a", model, degrees), "degrees per second")
    in_g = changed(case, tmp_path / "in_g", times(1.0 / 9.80665, "a"))
    refused(gap(tmp_path / "b", model, in_g), "in g")
    turned = 'facing = "left"', 'facing = "right"'
    refused(gap(tmp_path / "c", changed_model(case, tmp_path / "t.toml", turned), case), "facing =")
    sides = [('side = "left"', 'side = "x"'), ('side = "right"', 'side = "left"'), ('"x"', '"right"')]
    refused(gap(tmp_path / "d", changed_model(case, tmp_path / "s.toml", *sides), case), "sides")
    still = changed(case, tmp_path / "still", reference=slower)
    refused(gap(tmp_path / "e", model, still), "speed input is 0")
    backwards = changed(case, tmp_path / "backwards", reference=reversed_in_time)
    refused(gap(tmp_path / "f", model, backwards), "is unrelated to the speed input")


def slower(columns):
    return {**columns, "speed": 1e-3 * columns["speed"], "yaw_rate": 1e-3 * columns["yaw_rate"]}


def reversed_in_time(columns):
    """Another drive: the same one backwards, with a sine in place of its speed."""
    return {**columns, "speed": np.sin(2.0 * columns["t"]), "yaw_rate": columns["yaw_rate"][::-1]}


@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_noise_that_is_declared_wrong_is_said_with_the_estimate(case, tmp_path, factor):
    text = (case / "model.toml").read_text("utf-8")
    declared = [line for line in text.splitlines() if "gyro_noise" in line or "accel_noise" in line]
    swaps = [(line, f"{line.split('=')[0]}= {float(line.split('=')[1]) * factor:.6g}") for line in declared]
    made = gap(tmp_path / "out", changed_model(case, tmp_path / "model.toml", *swaps), case)
    assert made.code == 0, made.err
    assert made.names == []
    said = next(line for line in made.out.splitlines() if "[imu] gyro_noise" in line)
    assert ("smaller" if factor > 1.0 else "larger") in said
    estimate = float(said.split("about ")[1].split()[0])
    assert estimate == pytest.approx(float(declared[0].split("=")[1]), rel=0.1)


def test_a_drive_with_turns_and_stops_is_plausible_and_shows_all_but_the_temperature(problem):
    lines = check_plausibility(problem.nodes, problem.inputs, problem.speed_sources, "log")
    assert all("temperature" in line for line in lines)
