"""Calibration from a table of pose means, by the verb."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from generators.poses import EARTH, GRAVITY, Errors
from hubodo.calibration.file import read_calibration
from hubodo.cli import main

ACCEL = Errors((0.2, -0.3, 0.1), (0.01, -0.02, 0.005), {"xz": 0.004, "zx": -0.006})
GYRO = Errors((0.01, -0.02, 0.015), (0.01, -0.02, 0.005))
SIGMA = 2e-3


def write(path, columns):
    rows = np.column_stack(list(columns.values()))
    lines = [f"pose {k}," + ",".join(f"{x:.9g}" for x in row) for k, row in enumerate(rows)]
    path.write_text("\n".join([",".join(["label", *columns]), *lines]))


def poses(seed=1, count=24):
    """Return columns of means, and gravity in node axes."""
    rng = np.random.default_rng(seed)
    force = Rotation.random(count, rng=rng).inv().apply([0.0, 0.0, GRAVITY])
    accel = ACCEL.measure(force) + SIGMA * rng.standard_normal(force.shape)
    gyro = GYRO.measure(np.zeros_like(force)) + 1e-5 * rng.standard_normal(force.shape)
    names = ("gx", "gy", "gz", "ax", "ay", "az")
    return dict(zip(names, np.hstack([gyro, accel]).T, strict=True)), force


def run(tmp_path, columns, *options):
    write(tmp_path / "means.csv", columns)
    log, out = str(tmp_path / "means.csv"), str(tmp_path / "c.toml")
    return main(["calibrate", "imu", log, "--node", "imu", "-o", out, "--gravity", str(GRAVITY), *options])


@pytest.mark.parametrize("knocked", [None, 7])
def test_24_means_calibrate_both_triads_and_a_contradictory_one_is_named(tmp_path, capsys, knocked):
    columns, _ = poses()
    if knocked is not None:
        for name in ("ax", "ay", "az"):
            columns[name][knocked] *= 1.005
    assert run(tmp_path, columns, "--means", "--json", "--report", str(tmp_path / "page.html")) == 0
    result = json.loads(capsys.readouterr().out)
    assert [it["row"] for it in result["rests"]] == [k + 1 for k in range(24) if k != knocked]
    assert any("pose 8 rejected" in note for note in result["notes"]) == (knocked == 7)
    effects = result["effects"]
    for name, truth in (("accel_bias", ACCEL.b), ("accel_scale_factor", ACCEL.e), ("gyro_bias", GYRO.b)):
        for axis, true in zip("xyz", truth, strict=True):
            it = effects[name][axis]
            assert 0.0 < it["sigma"] < 2e-3
            assert abs(it["value"] - true) < 4 * it["sigma"]
    assert read_calibration(tmp_path / "c.toml").nodes["imu"].effects["accel_bias"].method.startswith("accel")
    assert "pose 24" in (tmp_path / "page.html").read_text()


def test_one_axis_is_calibrated_by_its_reference_and_three_with_their_cross_axis_terms(tmp_path, capsys):
    columns, force = poses(count=12)
    one = {"az": columns["az"], "ref_az (g)": force[:, 2] / 9.80665, "sigma_az": np.full(12, 0.1)}
    assert run(tmp_path, one, "--means", "--json") == 0
    result = json.loads(capsys.readouterr().out)["effects"]
    assert set(result) == {"accel_bias", "accel_scale_factor"} and set(result["accel_bias"]) == {"z"}
    # The stated noise of 0.1 m/s² leaves 0.1 / √12; cross-axis errors of 0.06 m/s² are within it.
    assert result["accel_bias"]["z"]["sigma"] == pytest.approx(0.1 / np.sqrt(12), rel=0.1)
    three = {name: columns[name] for name in ("ax", "ay", "az")}
    three |= {f"ref_a{axis}": force[:, k] for k, axis in enumerate("xyz")}
    assert run(tmp_path, three, "--means", "--json") == 0
    effects = json.loads(capsys.readouterr().out)["effects"]
    for name, true in (("xz", 0.004), ("zx", -0.006), ("yx", 0.0)):
        it = effects["accel_nonorthogonality"][name]
        assert abs(it["value"] - true) < 4 * it["sigma"] < 4e-3


def test_a_precise_gyro_is_calibrated_by_earth_rate_in_means(tmp_path, capsys):
    columns, _ = poses()
    rng, latitude = np.random.default_rng(2), 0.8
    attitudes = Rotation.random(24, rng=rng).inv()
    errors = Errors((2e-5, -1e-5, 1e-5), (0.01, -0.02, 0.005))
    rate = attitudes.apply(EARTH * np.array([0.0, np.cos(latitude), np.sin(latitude)]))
    gyro = errors.measure(rate) + 1e-7 * rng.standard_normal(rate.shape)
    accel = ACCEL.measure(attitudes.apply([0.0, 0.0, GRAVITY])) + SIGMA * rng.standard_normal(rate.shape)
    columns = dict(zip(columns, np.hstack([gyro, accel]).T, strict=True))
    stated = ["--mean-sigma", "gyro=1e-7", "--latitude-deg", str(np.degrees(latitude))]
    assert run(tmp_path, columns, "--means", "--json", *stated) == 0
    scale = json.loads(capsys.readouterr().out)["effects"]["gyro_scale_factor"]
    for axis, true in zip("xyz", errors.e, strict=True):
        assert abs(scale[axis]["value"] - true) < 4 * scale[axis]["sigma"] < 0.02


@pytest.mark.parametrize(
    "change, options, words",
    [
        (lambda c, f: c, (), "--means"),
        (lambda c, f: {"az": c["az"]}, ("--means",), "ref_az"),
        (lambda c, f: {k: v[:10] for k, v in c.items()}, ("--means",), "--mean-sigma"),
        (lambda c, f: {"az": c["az"], "ref_az": f[:, 2] / 9.8}, ("--means",), "9.84 times"),
        (lambda c, f: {"az": c["az"], "ref_az": -f[:, 2]}, ("--means",), "sign"),
        (lambda c, f: {"gz": c["gz"], "gx": c["gx"], "gy": c["gy"]}, ("--means",), "ref_gz"),
        (lambda c, f: {**c, "ax": np.where(f[:, 0] > 5, np.nan, c["ax"])}, ("--means",), "lacks a mean"),
        (lambda c, f: c, ("--means", "--table-rate-deg-s", "10"), "ref_gz"),
        (lambda c, f: c, ("--mean-sigma", "0.1"), "--means"),
        (lambda c, f: c, ("--means", "--mean-sigma", "0"), "above 0"),
        (lambda c, f: {"noise": f[:, 0], "other": f[:, 1]}, ("--means",), "--columns"),
    ],
)
def test_what_is_missing_or_contradictory_is_named(tmp_path, capsys, change, options, words):
    assert run(tmp_path, change(*poses()), *options) in (1, 2)
    error = capsys.readouterr().err.strip()
    assert words in error and len(error.splitlines()) == 1
