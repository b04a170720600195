"""The workflow on a bench at rest, and on a drive whose inputs are what its own gyros measured."""

import numpy as np

from gap_matrix.make_case import make
from gap_runs import changed_model, gap
from hubodo.gap.problem.log_inputs import read_trace
from hubodo.log.csv_folder import read_folder, write_folder
from hubodo.recording import Recording, Table

SEED = 12
GRAVITY = 9.80665


def test_a_gyro_bias_is_named_on_a_bench_at_rest_and_what_rest_cannot_show_is_said(tmp_path):
    hidden = make(
        tmp_path / "log",
        SEED,
        ["gyro_bias"],
        "strong",
        kind="bench",
        scope="left",
        duration=40.0,
        rate_hz=50.0,
    )
    made = gap(tmp_path / "out", tmp_path / "log" / "model.toml", tmp_path / "log")
    assert made.code == 0, made.err
    assert made.names == [("gyro_bias", "left")]
    for axis, value in made.result["found"][0]["parameters"].items():
        assert abs(value["value"] - hidden[0].parameters[axis]) < 4.0 * value["sigma"], (axis, value)
    assert any("nothing moves" in line for line in made.result["warnings"])


def body_node(reference, rng):
    """A node on the vehicle, its axes those of the body, as the reference moves it."""
    t = reference.t[1:-1:2]
    slope = np.gradient(np.convolve(reference["speed"], np.ones(25) / 25, "same"), reference.t)[1:-1:2]
    speed, yaw = reference["speed"][1:-1:2], reference["yaw_rate"][1:-1:2]
    zero = np.zeros_like(t)
    values = np.stack([zero, zero, yaw, slope, yaw * speed, zero + GRAVITY])
    values += rng.standard_normal(values.shape) * np.repeat([0.002, 0.3], 3)[:, None]
    return Table({"t": t, **dict(zip(("gx", "gy", "gz", "ax", "ay", "az"), values, strict=True))})


def test_without_a_reference_the_gyros_of_the_log_drive_the_model(tmp_path):
    make(tmp_path / "case", SEED, ["lever_arm"], "strong", scope="left", duration=40.0, rate_hz=50.0)
    read = read_folder(tmp_path / "case")
    frame = body_node(read.reference, np.random.default_rng(SEED))
    write_folder(Recording({**read.nodes, "frame": frame}), tmp_path / "log")
    model = changed_model(
        tmp_path / "case",
        tmp_path / "model.toml",
        ('speed = "reference.speed"', 'speed = "nodes"'),
        ('yaw_rate = "reference.yaw_rate"', 'yaw_rate = "frame.gz"'),
        ("speed_noise = 0.0005", "speed_noise = 0.001"),
        ("yaw_rate_noise = 0.0002", "yaw_rate_noise = 0.002"),
    )
    made = gap(tmp_path / "out", model, tmp_path / "log")
    assert made.code == 0, made.err
    assert made.names[:1] == [("lever_arm", "left")]


def test_an_input_that_scatters_more_than_declared_is_said_and_not_taken_for_an_effect(nothing, tmp_path):
    model = changed_model(nothing, tmp_path / "model.toml", ("speed_noise = 0.0005", "speed_noise = 0.00001"))
    made = gap(tmp_path / "out", model, nothing)
    assert made.names == []
    said = [line for line in made.result["warnings"] if line.startswith("reference.speed scatters by 0.00")]
    assert len(said) == 1
    assert 0.0004 < float(said[0].split()[3]) < 0.0006
    as_declared = gap(tmp_path / "declared", nothing / "model.toml", nothing)
    assert not any("scatters" in line for line in as_declared.result["warnings"])


def test_a_column_is_read_where_it_is_finite_and_missing_where_it_nowhere_is():
    t = np.arange(4.0)
    table = Table({"t": t + 100.0, "temperature": np.array([20.0, np.nan, 22.0, 23.0]), "supply": t * np.nan})
    trace = read_trace(table, "temperature", 100.0)
    assert trace.values.tolist() == [20.0, 22.0, 23.0]
    assert read_trace(table, "supply", 100.0) is None and read_trace(table, "humidity", 100.0) is None
