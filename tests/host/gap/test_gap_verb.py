"""`hubodo gap`: names what is missing, writes a model that needs no more, and answers to the user's word."""

import json
import tomllib

from gap_matrix.make_case import make
from gap_runs import gap
from hubodo.effects import BY_NAME

SEED = 3


def test_a_leaning_wheel_is_named_and_the_model_that_was_written_leaves_no_gap(camber, named, tmp_path):
    (folder, hidden), first = camber, named
    assert first.code == 0, first.err
    assert first.err == ""
    assert first.names == [("wheel_camber", "right")]
    found = first.result["found"][0]
    angle = found["parameters"]["angle"]
    assert abs(angle["value"] - hidden.parameters["angle"]) < 3.0 * angle["sigma"]
    assert found["confidence"] > 0.99
    assert first.result["held_out_gap"]["after"] < first.result["held_out_gap"]["before"]
    assert "right.az, all the time" in found["where"]
    assert "the wheel leans (right)" in first.out.lower()

    text = (named.folder / "model.toml").read_text("utf-8")
    assert tomllib.loads(text)["nodes"]["right"]["effects"]["wheel_camber"]["angle"] == angle["value"]
    assert "# Added by hubodo gap" in text

    again = gap(tmp_path / "again", named.folder / "model.toml", folder)
    assert (again.code, again.result["verdict"], again.names) == (0, "no_gap", [])


def test_nothing_is_found_where_nothing_is_hidden(nothing, tmp_path):
    made = gap(tmp_path, nothing / "model.toml", nothing, "--json")
    assert (made.code, made.result["verdict"], made.result["found"]) == (0, "no_gap", [])
    assert json.loads(made.out) == made.result
    assert (tmp_path / "report.html").stat().st_size < 6e6


def test_a_rejected_name_is_not_given_and_its_absence_explained(tmp_path):
    make(tmp_path / "log", SEED, ["tyre_growth"], "strong", scope="right", duration=60.0, rate_hz=50.0)
    words = ("--reject", "tyre_growth", "--explain", "tyre_growth", "--explain", "gyro_lag", "--json")
    made = gap(tmp_path / "out", tmp_path / "log" / "model.toml", tmp_path / "log", *words)
    assert made.code == 0, made.err
    assert "tyre_growth" not in [name for name, _ in made.names]
    assert made.names or made.result["verdict"] == "unexplained"
    rejected, lag = json.loads(made.out)["explain"]
    assert rejected["summary"] == "tyre_growth was not considered: --reject tyre_growth"
    assert lag["effect"] == "gyro_lag"
    assert lag["rows"] and all(row["beaten_by"] for row in lag["rows"])


def test_an_accepted_name_stays_as_unsure_as_it_is_and_what_is_missing_is_found_beside_it(camber, tmp_path):
    case, _ = camber
    made = gap(tmp_path / "out", case / "model.toml", case, "--accept", "gyro_scale_factor")
    assert made.code == 0, made.err
    names = [name for name, _ in made.names]
    assert names[0] == "gyro_scale_factor"
    assert "wheel_camber" in names
    assert made.result["found"][0]["confidence"] < 0.5


def test_an_accepted_name_that_no_log_like_this_can_show_is_said(nothing, tmp_path):
    made = gap(tmp_path / "out", nothing / "model.toml", nothing, "--accept", "accel_saturation")
    assert made.names == []
    assert "accel_saturation: accepted, but nothing in this log shows it" in made.result["warnings"]


def test_every_effect_has_words_for_people():
    words = {kind.meaning for kind in BY_NAME.values()}
    assert len(words) == len(BY_NAME) and "" not in words
