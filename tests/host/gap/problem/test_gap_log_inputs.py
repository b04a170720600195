"""Inputs from the log: a bench at rest, gyros as inputs, declared noise of inputs, columns with gaps."""

import numpy as np

from gap_matrix.make_case import write_case
from gap_runs import run_gap, write_changed_model
from hubodo.gap.problem.log_inputs import read_trace
from hubodo.log.csv_folder import read_folder, write_folder
from hubodo.recording import Recording, Table

SEED = 12
GRAVITY = 9.80665


def test_a_gyro_bias_is_found_at_rest_and_the_missing_motion_raises_a_warning(tmp_path):
    hidden = write_case(
        tmp_path / "log",
        SEED,
        ["gyro_bias"],
        "strong",
        kind="bench",
        scope="left",
        duration=33.0,
        rate_hz=30.0,
    )
    run = run_gap(tmp_path / "out", tmp_path / "log" / "model.toml", tmp_path / "log")
    assert run.code == 0, run.err
    assert run.names == [("gyro_bias", "left")]
    for axis, value in run.result["found"][0]["parameters"].items():
        assert abs(value["value"] - hidden[0].parameters[axis]) < 4.0 * value["sigma"], (axis, value)
    assert any("nothing moves" in line for line in run.result["warnings"])


def simulate_body_node(reference, rng):
    """Return the readings of a node on the vehicle body, aligned with its axes, for the reference motion."""
    t = reference.t[1:-1:2]
    acceleration = np.gradient(np.convolve(reference["speed"], np.ones(25) / 25, "same"), reference.t)[1:-1:2]
    speed, yaw_rate = reference["speed"][1:-1:2], reference["yaw_rate"][1:-1:2]
    zero = np.zeros_like(t)
    values = np.stack([zero, zero, yaw_rate, acceleration, yaw_rate * speed, zero + GRAVITY])
    values += rng.standard_normal(values.shape) * np.repeat([0.002, 0.3], 3)[:, None]
    return Table({"t": t, **dict(zip(("gx", "gy", "gz", "ax", "ay", "az"), values, strict=True))})


def test_the_gyros_of_the_log_replace_a_missing_reference(tmp_path):
    write_case(tmp_path / "case", SEED, ["lever_arm"], "strong", scope="left", duration=33.0, rate_hz=30.0)
    log = read_folder(tmp_path / "case")
    frame = simulate_body_node(log.reference, np.random.default_rng(SEED))
    write_folder(Recording({**log.nodes, "frame": frame}), tmp_path / "log")
    model = write_changed_model(
        tmp_path / "case",
        tmp_path / "model.toml",
        ('speed = "reference.speed"', 'speed = "nodes"'),
        ('yaw_rate = "reference.yaw_rate"', 'yaw_rate = "frame.gz"'),
        ("speed_noise = 0.0005", "speed_noise = 0.001"),
        ("yaw_rate_noise = 0.0002", "yaw_rate_noise = 0.002"),
    )
    run = run_gap(tmp_path / "out", model, tmp_path / "log")
    assert run.code == 0, run.err
    assert run.names[:1] == [("lever_arm", "left")]


def test_an_input_noisier_than_declared_raises_a_warning_and_no_finding(clean_log, tmp_path):
    model = write_changed_model(
        clean_log, tmp_path / "model.toml", ("speed_noise = 0.0005", "speed_noise = 0.00001")
    )
    run = run_gap(tmp_path / "out", model, clean_log)
    assert run.names == []
    warnings = [
        line for line in run.result["warnings"] if line.startswith("reference.speed scatters by 0.00")
    ]
    assert len(warnings) == 1
    assert 0.0004 < float(warnings[0].split()[3]) < 0.0006
    run_with_true_noise = run_gap(tmp_path / "declared", clean_log / "model.toml", clean_log)
    assert not any("scatters" in line for line in run_with_true_noise.result["warnings"])


def test_non_finite_values_of_a_column_are_dropped_and_an_empty_column_is_missing():
    t = np.arange(4.0)
    table = Table({"t": t + 100.0, "temperature": np.array([20.0, np.nan, 22.0, 23.0]), "supply": t * np.nan})
    trace = read_trace(table, "temperature", 100.0)
    assert trace.values.tolist() == [20.0, 22.0, 23.0]
    assert read_trace(table, "supply", 100.0) is None and read_trace(table, "humidity", 100.0) is None
