"""Two logs of one vehicle: a change is named with its size, and no change is none."""

import io
import json
from contextlib import redirect_stderr, redirect_stdout

import numpy as np
import pytest

from gap_matrix import cases, recording
from gap_matrix.dose import STRENGTHS, Meter
from gap_matrix.judge.two_drives import changed, null, pair
from hubodo.cli import main

# A third of the usual rate: as many nats show as much in a third of the time. Few seconds leave few blocks of
# them to tell a change by, and as many to see that there is none.
SEED, SECONDS, RATE_HZ, NULL_S = 7, 66.0, 30.0, 33.0


def test_a_knocked_sensor_is_named_and_by_how_much_it_moved(tmp_path):
    hidden, result = changed("lever_arm", SEED, SECONDS, tmp_path, RATE_HZ)
    assert result.p_value < 1e-3
    assert (result.changes[0].effect, result.changes[0].scope) == ("lever_arm", hidden.scope)
    for name, (before, after, change) in result.changes[0].values.items():
        assert abs(change.value - hidden.parameters[name]) < 3.0 * change.sigma, name
        assert after.value - before.value == pytest.approx(change.value)


@pytest.mark.parametrize("seed", [SEED, SEED + 1])
def test_what_is_alike_in_both_is_no_change(seed, tmp_path):
    result = null(seed, NULL_S, tmp_path, RATE_HZ)
    assert not result.has_changed
    assert result.changes == ()


def test_the_gap_matrix_of_two_drives_has_one_vehicle_and_two_roads():
    first, second = pair(SEED, SECONDS)
    assert (first.radius, first.track, first.facing) == (second.radius, second.track, second.facing)
    assert not np.allclose(first.drive.motion.speed, second.drive.motion.speed)


def verb(*words):
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(["gap", *map(str, words)])
    return code, out.getvalue(), err.getvalue()


def test_the_verb_compares_two_logs(tmp_path):
    setups = pair(SEED, SECONDS, RATE_HZ)
    worn = Meter(setups[1]).dose(cases.hidden_effect(setups[1], "wheel_radius", "all"), STRENGTHS["strong"])[
        0
    ]
    recording.write(setups[0], [], tmp_path / "a", {})
    recording.write(setups[1], [worn], tmp_path / "b", {})
    logs = ("--before", tmp_path / "a", "--after", tmp_path / "b", "-o", tmp_path / "out")
    code, out, err = verb(tmp_path / "a" / "model.toml", *logs)
    assert code == 0, err
    assert "the wheel radius differs from the model (all nodes)" in out
    told = json.loads((tmp_path / "out" / "change.json").read_text("utf-8"))
    error = told["changes"][0]["parameters"]["error"]
    assert abs(error["change"]["value"] - worn.parameters["error"]) < 3.0 * error["change"]["sigma"]
    assert told["p_value"] < 1e-3
    # The other way round it is as much smaller.
    logs = ("--before", tmp_path / "b", "--after", tmp_path / "a", "-o", tmp_path / "back")
    assert verb(tmp_path / "a" / "model.toml", *logs)[0] == 0
    back = json.loads((tmp_path / "back" / "change.json").read_text("utf-8"))
    error = back["changes"][0]["parameters"]["error"]
    assert abs(error["change"]["value"] + worn.parameters["error"]) < 3.0 * error["change"]["sigma"]


@pytest.mark.parametrize(
    ("words", "says"),
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
def test_words_that_do_not_go_together_are_refused(words, says, tmp_path):
    code, _, err = verb(*words, "-o", tmp_path / "out")
    assert code == 2
    assert says in err
    assert not (tmp_path / "out").exists()
