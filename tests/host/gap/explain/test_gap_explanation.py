"""`hubodo gap`: names what is missing, writes a model that needs no more, and answers to the user's word."""

import json
import tomllib
from types import SimpleNamespace

import pytest

from gap_matrix.make_case import make
from gap_runs import gap
from hubodo.effects import BY_NAME
from hubodo.gap.explain.explanation import explain_effect

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
    assert "accel_saturation: accepted, but not visible in this log" in made.result["warnings"]


def test_every_effect_has_words_for_people():
    words = {kind.meaning for kind in BY_NAME.values()}
    assert len(words) == len(BY_NAME) and "" not in words


def rival(name, scope="all", **values):
    """A candidate of a round, refitted or as the linear model saw it."""
    term = SimpleNamespace(effect=SimpleNamespace(name=name), scope=scope)
    made = {"gain": 20.0, "evidence": 9.0, "probability": 0.25, **values}
    return SimpleNamespace(term=term, candidate=SimpleNamespace(term=term), key=f"{name} {scope}", **made)


def round_of(best, *rivals, screened=()):
    return SimpleNamespace(best=best, hypotheses=rivals, screened=screened)


def why(*rounds, name="gyro_bias", found=(), model=("wheel_camber",), rejected=False):
    effects = [SimpleNamespace(effect=SimpleNamespace(name=it)) for it in model]
    result = SimpleNamespace(
        search=SimpleNamespace(rounds=rounds), found=found, model=SimpleNamespace(effects=effects)
    )
    return explain_effect(result, name, rejected)


CAMBER, BIAS = rival("wheel_camber", "right"), rival("gyro_bias")
FOUND = SimpleNamespace(
    effect="wheel_camber", scope="right", confidence=0.75, rivals=[("gyro_bias", "left", 12.3, 0.25)]
)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (why(model=("gyro_bias", "wheel_camber")), "is in the model file already"),
        (why(found=[FOUND], name="wheel_camber"), "wheel_camber was found (right)"),
        (why(model=("gyro_bias",), rejected=True), "--reject gyro_bias"),
        (
            why(found=[FOUND]),
            "gyro_bias (left) lost to wheel_camber (right) when each name was reconsidered: gain 12.3",
        ),
        (why(), "could not be tested: this log has no node"),
        (why(name="gyro_quantization"), "on the scatter of the samples; there is no sign of it"),
        (why(round_of(BIAS, BIAS, CAMBER)), "gyro_bias (all) was added in round 1 and removed later"),
        (why(round_of(None, BIAS)), "gained 20.0 in log-likelihood, too little to be more than chance"),
        (why(round_of(CAMBER, CAMBER, BIAS)), "round 1 but wheel_camber (right) explained it better"),
        (
            why(round_of(CAMBER, CAMBER, BIAS), round_of(CAMBER, CAMBER, rival("gyro_bias", gain=20.5))),
            "gyro_bias (all) gained 20.5 in log-likelihood in round 2 but",
        ),
        (
            why(round_of(CAMBER, CAMBER, screened=[rival("gyro_bias", gain=3.0, evidence=-0.5)])),
            "gain 3.0 in log-likelihood (all), less than its free parameters cost (ln Bayes factor -0.5)",
        ),
        (
            why(
                round_of(CAMBER, CAMBER, screened=[rival("gyro_bias", gain=9.0, evidence=7.0)]),
                round_of(
                    CAMBER,
                    CAMBER,
                    screened=[
                        rival("gyro_bias", "left", gain=5.0, evidence=1.0),
                        rival("gyro_bias", "right", gain=4.0, evidence=2.0),
                        rival("gyro_bias", "right", gain=8.0, evidence=3.0),
                    ],
                ),
            ),
            "in the last round it would gain 4.0 in log-likelihood (right), less than others gain",
        ),
    ],
)
def test_what_became_of_an_effect_is_said_by_the_best_that_was_tried_of_it(made, words):
    assert words in made.summary


def test_each_scope_of_an_effect_has_one_row_in_each_round_and_what_beat_it():
    screened = [rival("gyro_bias", "left", gain=5.0), rival("gyro_bias", gain=4.0), rival("gyro_lag")]
    made = why(round_of(CAMBER, CAMBER, BIAS, screened=screened), round_of(BIAS, BIAS), round_of(None, BIAS))
    rows = [(row.round, row.scope, row.gain, row.probability, row.beaten_by) for row in made.rows]
    assert rows == [
        (1, "all", 20.0, 0.25, "wheel_camber (right)"),
        (1, "left", 5.0, None, "wheel_camber (right)"),
        (2, "all", 20.0, 0.25, ""),
        (3, "all", 20.0, 0.25, "no effect was significant"),
    ]
