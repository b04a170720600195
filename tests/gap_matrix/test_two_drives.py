"""Two logs of one vehicle: a change is found with its size, and none if nothing changed."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout

import numpy as np
import pytest

from gap_matrix import cases, recording
from gap_matrix.dose import STRENGTHS, GainMeter
from gap_matrix.judge.two_drives import compare_changed, compare_unchanged, draw_two_setups
from hubodo.cli import main
from repetitions import first_and_more

# A third of the usual rate: the gain in nats is the same, the search takes a third of the time. A change
# needs more blocks of samples than its absence.
SEED, DURATION, RATE_HZ, NULL_DURATION = 7, 66.0, 30.0, 33.0


@pytest.mark.repeat
def test_a_displaced_sensor_is_found_with_its_displacement(tmp_path):
    hidden, result = compare_changed("lever_arm", SEED, DURATION, tmp_path, RATE_HZ)
    assert result.p_value < 1e-3
    assert (result.changes[0].effect, result.changes[0].scope) == ("lever_arm", hidden.scope)
    for name, (before, after, change) in result.changes[0].values.items():
        assert abs(change.value - hidden.parameters[name]) < 3.0 * change.sigma, name
        assert after.value - before.value == pytest.approx(change.value)


@pytest.mark.parametrize("seed", first_and_more(SEED, SEED + 1))
def test_an_effect_of_both_drives_is_no_change(seed, tmp_path):
    result = compare_unchanged(seed, NULL_DURATION, tmp_path, RATE_HZ)
    assert not result.has_changed
    assert result.changes == ()


def test_two_drives_have_one_vehicle_and_different_motions():
    first, second = draw_two_setups(SEED, DURATION)
    assert (first.radius, first.track, first.facing) == (second.radius, second.track, second.facing)
    assert not np.allclose(first.drive.motion.speed, second.drive.motion.speed)


def run_gap_verb(*arguments):
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(["gap", *map(str, arguments)])
    return code, out.getvalue(), err.getvalue()


@pytest.mark.parametrize("sign", first_and_more(1.0, -1.0))
def test_the_verb_compares_two_logs_in_either_order(sign, tmp_path):
    """The sign of the change follows the order of the logs."""
    setups = draw_two_setups(SEED, DURATION, RATE_HZ)
    worn_tyre = GainMeter(setups[1]).scale_to_gain(
        cases.draw_hidden_effect(setups[1], "wheel_radius", "all"), STRENGTHS["strong"]
    )[0]
    recording.write_case_files(setups[0], [], tmp_path / "a", {})
    recording.write_case_files(setups[1], [worn_tyre], tmp_path / "b", {})
    before, after = (tmp_path / name for name in ("ab" if sign > 0.0 else "ba"))
    logs = ("--before", before, "--after", after, "-o", tmp_path / "out")
    code, out, err = run_gap_verb(tmp_path / "a" / "model.toml", *logs)
    assert code == 0, err
    assert "the wheel radius differs from the model (all nodes)" in out
    result = json.loads((tmp_path / "out" / "change.json").read_text("utf-8"))
    error = result["changes"][0]["parameters"]["error"]
    difference = error["change"]["value"] - sign * worn_tyre.parameters["error"]
    assert abs(difference) < 3.0 * error["change"]["sigma"]
    assert result["p_value"] < 1e-3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("m.toml", "--before", "a"), "go together"),
        (
            ("m.toml", "--before", "a", "--after", "b", "--explain", "gyro_bias"),
            "--explain goes with one log",
        ),
        (("m.toml", "c", "--before", "a", "--after", "b"), "no other log"),
        (("--before", "a", "--after", "b"), "MODEL"),
    ],
)
def test_incompatible_arguments_are_refused(arguments, message, tmp_path):
    code, _, err = run_gap_verb(*arguments, "-o", tmp_path / "out")
    assert code == 2
    assert message in err
    assert not (tmp_path / "out").exists()
