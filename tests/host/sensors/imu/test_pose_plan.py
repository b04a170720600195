"""The plan of poses: its sigmas are met by a calibration of the planned poses."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from generators.poses import GRAVITY, Errors
from hubodo.cli import main
from hubodo.sensors.imu.pose_plan import choose_directions, plan_poses
from hubodo.sensors.imu.scalar_calibration import fit_scalar_calibration
from hubodo.sensors.north.drift import DriftNoise


def test_the_planned_sigmas_are_the_errors_of_the_planned_poses():
    density, rng = 0.002, np.random.default_rng(7)
    plan = plan_poses(DriftNoise(density, 0.0, 0.0), 1.2e-3, 5.0)
    programme = plan.target_programme
    assert programme.bias_sigma <= 1.2e-3
    # A standstill of 2 s loses a sixth at both ends.
    noise = density / np.sqrt(programme.standstill * 2 / 3)
    unit = np.array([it / np.linalg.norm(it) for it in choose_directions(len(programme.directions))])
    accel, errors = Errors((0.2, -0.1, 0.1), (0.004, -0.005, 0.002)), []
    for _ in range(150):
        force = Rotation.from_rotvec(0.02 * rng.standard_normal((len(unit), 3))).apply(GRAVITY * unit)
        mean = accel.measure(force) + noise * rng.standard_normal(force.shape)
        fit = fit_scalar_calibration(mean, GRAVITY, np.full(mean.shape, noise), allow_partial=True)
        errors.append(fit.triad.bias - accel.b)
    ratio = np.sqrt(np.mean(np.square(errors), axis=0)) / programme.bias_sigmas
    assert ratio == pytest.approx(1.0, abs=0.25)


def test_longer_standstills_do_not_beat_the_bias_instability():
    plan = plan_poses(DriftNoise(0.002, 0.01, 0.0), 1e-4, 5.0)
    assert plan.target_programme is None
    assert all(it.bias_sigma > 1e-3 for it in plan.programmes)


def test_the_verb_prints_the_plan_and_asks_for_the_noise(tmp_path, capsys):
    assert main(["calibrate", "plan", "--noise-density", "0.002", "--bias-sigma", "0.001", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert max(result["wanted"]["bias_sigma"]) <= 0.001
    counts = [len(it["directions"]) for it in result["programmes"]]
    assert counts == sorted(counts) and counts[0] == 9
    assert main(["calibrate", "plan", "--noise-density", "1e-3", "--bias-sigma", "1e-9"]) == 0
    assert "cannot be reached" in capsys.readouterr().out
    terms = {name: {"value": 1e-3} for name in "NBK"}
    (tmp_path / "allan.json").write_text(json.dumps({"coefficients": terms, "channel": "az"}))
    assert main(["calibrate", "plan", "--allan", str(tmp_path / "allan.json"), "--bias-sigma", "0.1"]) == 0
    assert "9 poses" in capsys.readouterr().out
    (tmp_path / "allan.json").write_text(json.dumps({"coefficients": terms, "channel": "gz"}))
    for options, words in (
        ([], "--noise-density"),
        (["--allan", str(tmp_path / "allan.json")], "is of gz"),
        (["--allan", "x", "--bias-instability", "1"], "belongs to --noise-density"),
    ):
        assert main(["calibrate", "plan", *options]) == 2
        assert words in capsys.readouterr().err
