"""Standstills among steady turns: detected if the record shows them, otherwise refused."""

import json

import numpy as np
import pytest

from generators.odd_records import disturb
from generators.steady_turns import steady_turns
from hubodo.cli import main
from hubodo.log.csv_folder import write_folder
from hubodo.recording import Recording, Table


def heading(path, capsys, *words):
    status = main(["heading", str(path), *words, "--json"])
    out, err = capsys.readouterr()
    return json.loads(out) if status == 0 else err


def folder(path, seed, **world):
    t, gyro, accel, true_heading = steady_turns(seed, scale_sigma=0.01, **world)
    columns = dict(zip(("t", "gx", "gy", "gz", "ax", "ay", "az"), (t, *gyro.T, *accel.T), strict=True))
    write_folder(Recording({"imu": Table(columns)}), path)
    return path, np.degrees(true_heading[-1])


@pytest.mark.parametrize(
    "world, spans",
    [
        ({"first": 100.0, "segments": 8, "length": 20.0}, [(0, 100)]),
        ({"standstills": (2, 5, 8), "length": 20.0}, [(40, 60), (100, 120), (160, 180)]),
        ({"standstills": (0, 7), "segments": 8, "length": 20.0, "warmup": 0.2}, [(0, 20), (140, 160)]),
    ],
)
def test_standstills_among_steady_turns_are_found_and_listed(tmp_path, capsys, world, spans):
    path, truth = folder(tmp_path / "log", 1, **world)
    result = heading(path, capsys)
    assert np.allclose(result["rests"], spans, atol=1.0)
    assert abs(result["turned_deg"]["heading"] - truth) < 3 * result["sigma_deg"]
    assert any("with a constant rate are turns" in note for note in result["notes"])
    assert main(["heading", str(path)]) == 0
    assert f"standstills: {result['rests'][0][0]:.1f}.." in capsys.readouterr().out


@pytest.mark.parametrize("world", [{"fastest": 25.0}, {"fastest": 1.0}, {"fastest": 25.0, "lean": 0.1}])
def test_steady_turns_alone_are_no_standstill(tmp_path, capsys, world):
    for seed in (0, 2):
        path, _ = folder(tmp_path / str(seed), seed, standstills=(), segments=8, length=20.0, **world)
        assert "a steady turn looks like a standstill" in heading(path, capsys)


@pytest.mark.parametrize("seed", [[3, 5], [9, 5]])
def test_a_turn_with_the_small_rate_of_a_bias_is_no_standstill(tmp_path, capsys, seed):
    """A single quiet segment between steady turns of its own length needs a confirmation."""
    path, _ = folder(tmp_path / "log", seed, standstills=())
    assert "a steady turn looks like a standstill" in heading(path, capsys)


def test_two_sets_of_standstills_with_different_biases_are_refused(tmp_path, capsys):
    """The turn at 240 s has 0.17 deg/s: with the start it is as probable as the end, and 33 degrees apart."""
    path, _ = folder(tmp_path / "log", [206, 4], standstills=(0, 9))
    assert "may be one as well" in heading(path, capsys)


def test_a_slow_turn_after_a_standstill_is_divided_from_it_beside_fast_ones(tmp_path, capsys):
    """The first turn has 1.3 deg/s, others 20: the noise is that of the samples, without the turns."""
    rng = np.random.default_rng([207, 5])
    t, gyro, accel, true = steady_turns([207, 4], standstills=(0, 9), scale_sigma=0.01)
    columns = dict(
        zip(
            ("t", "gx", "gy", "gz", "ax", "ay", "az"),
            (t, *disturb("vibration lines", t, gyro, accel, rng, 0.02 * np.pi / 180)[1].T, *accel.T),
            strict=True,
        )
    )
    write_folder(Recording({"imu": Table(columns)}), tmp_path / "log")
    result = heading(tmp_path / "log", capsys)
    assert np.allclose(result["rests"], [(0, 30), (270, 300)], atol=1.0)
    assert abs(result["turned_deg"]["heading"] - np.degrees(true[-1])) < 3 * result["sigma_deg"]


def test_the_file_of_one_gyro_is_enough(tmp_path, capsys):
    t, gyro, _, true_heading = steady_turns(1, first=60.0, segments=8, length=20.0)
    path = tmp_path / "gyro.csv"
    np.savetxt(path, np.column_stack([1e3 * t, np.degrees(gyro[:, 2])]), delimiter=",", header="t,rate")
    result = heading(path, capsys, "--columns", "t_ms,gz", "--unit", "deg/s")
    assert abs(result["turned_deg"]["heading"] - np.degrees(true_heading[-1])) < 3 * result["sigma_deg"]
    assert any("it has no gx, gy, ax, ay, az" in note for note in result["notes"])
    assert "the times look like ms" in heading(path, capsys, "--columns", "t,gz", "--unit", "deg/s")
