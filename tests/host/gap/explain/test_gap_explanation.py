"""`hubodo gap` finds the missing effect, writes a complete model, obeys --accept, --reject, --explain."""

import json
import tomllib
from types import SimpleNamespace

import pytest

from gap_matrix.make_case import write_case
from gap_runs import run_gap
from hubodo.effects import BY_NAME
from hubodo.gap.explain.explanation import _find_objection, explain_effect
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.state.terms import ModelTerm

SEED = 3


def test_camber_is_found_and_the_written_model_leaves_no_gap(camber_case, camber_run, tmp_path):
    folder, hidden = camber_case
    assert camber_run.code == 0, camber_run.err
    assert all(" %  " in line for line in camber_run.err.splitlines()), camber_run.err
    assert camber_run.names == [("wheel_camber", "right")]
    finding = camber_run.result["found"][0]
    angle = finding["parameters"]["angle"]
    assert abs(angle["value"] - hidden.parameters["angle"]) < 3.0 * angle["sigma"]
    assert finding["confidence"] > 0.99
    assert camber_run.result["held_out_gap"]["after"] < camber_run.result["held_out_gap"]["before"]
    assert "right.az, all the time" in finding["where"]
    assert "the wheel leans (right)" in camber_run.out.lower()

    text = (camber_run.folder / "model.toml").read_text("utf-8")
    assert tomllib.loads(text)["nodes"]["right"]["effects"]["wheel_camber"]["angle"] == angle["value"]
    assert "# Added by hubodo gap" in text

    second_run = run_gap(tmp_path / "again", camber_run.folder / "model.toml", folder)
    assert (second_run.code, second_run.result["verdict"], second_run.names) == (0, "no_gap", [])


def test_no_effect_is_found_in_a_clean_log(clean_log, tmp_path):
    run = run_gap(tmp_path, clean_log / "model.toml", clean_log, "--json", page=True)
    assert (run.code, run.result["verdict"], run.result["found"]) == (0, "no_gap", [])
    assert json.loads(run.out) == run.result
    assert (tmp_path / "report.html").stat().st_size < 6e6


def test_a_rejected_effect_is_not_found_and_its_rejection_is_explained(tmp_path):
    write_case(tmp_path / "log", SEED, ["tyre_growth"], "medium", scope="right", duration=40.0, rate_hz=30.0)
    options = ("--reject", "tyre_growth", "--explain", "tyre_growth", "--explain", "gyro_lag", "--json")
    run = run_gap(tmp_path / "out", tmp_path / "log" / "model.toml", tmp_path / "log", *options, page=True)
    assert run.code == 0, run.err
    assert "tyre_growth" not in [name for name, _ in run.names]
    assert run.names or run.result["verdict"] == "unexplained"
    rejected, lag = json.loads(run.out)["explain"]
    assert rejected["summary"] == "tyre_growth was not considered: --reject tyre_growth"
    assert lag["effect"] == "gyro_lag"
    assert lag["rows"] and all(row["beaten_by"] for row in lag["rows"])


def test_an_accepted_effect_keeps_its_low_confidence_and_the_true_one_is_found_too(camber_case, tmp_path):
    case, _ = camber_case
    run = run_gap(tmp_path / "out", case / "model.toml", case, "--accept", "gyro_scale_factor")
    assert run.code == 0, run.err
    names = [name for name, _ in run.names]
    assert names[0] == "gyro_scale_factor"
    assert "wheel_camber" in names
    assert run.result["found"][0]["confidence"] < 0.5


def test_an_accepted_effect_that_the_log_cannot_show_raises_a_warning(clean_log, tmp_path):
    run = run_gap(tmp_path / "out", clean_log / "model.toml", clean_log, "--accept", "accel_saturation")
    assert run.names == []
    assert "accel_saturation: accepted, but not visible in this log" in run.result["warnings"]


def test_every_effect_has_a_meaning_of_its_own():
    meanings = {kind.meaning for kind in BY_NAME.values()}
    assert len(meanings) == len(BY_NAME) and "" not in meanings


def build_candidate(name, scope="all", **values):
    """Return a stand-in for a candidate of a round, refitted or only screened."""
    term = SimpleNamespace(effect=SimpleNamespace(name=name), scope=scope)
    scores = {"gain": 20.0, "evidence": 9.0, "probability": 0.25, "objection": "", **values}
    return SimpleNamespace(term=term, candidate=SimpleNamespace(term=term), key=f"{name} {scope}", **scores)


def build_round(best, *candidates, screened=()):
    """Return a stand-in for a round of the search with its refitted and screened candidates."""
    return SimpleNamespace(best=best, hypotheses=candidates, screened=screened)


def explain(*rounds, name="gyro_bias", findings=(), model=("wheel_camber",), rejected=False):
    """Return what `--explain name` reports after these rounds, for a model with these effects."""
    effects = [SimpleNamespace(effect=SimpleNamespace(name=effect)) for effect in model]
    result = SimpleNamespace(
        search=SimpleNamespace(rounds=rounds),
        found=findings,
        refined=(),
        model=SimpleNamespace(effects=effects),
    )
    return explain_effect(result, name, rejected)


CAMBER, BIAS = build_candidate("wheel_camber", "right"), build_candidate("gyro_bias")
FINDING = SimpleNamespace(
    effect="wheel_camber", scope="right", confidence=0.75, rivals=[("gyro_bias", "left", 12.3, 0.25)]
)


@pytest.mark.parametrize(
    ("explanation", "expected_text"),
    [
        (explain(model=("gyro_bias", "wheel_camber")), "is in the model file already"),
        (explain(findings=[FINDING], name="wheel_camber"), "wheel_camber is named (right)"),
        (explain(model=("gyro_bias",), rejected=True), "--reject gyro_bias"),
        (
            explain(findings=[FINDING]),
            "gyro_bias (left) lost to wheel_camber (right) when each name was reconsidered: gain 12.3",
        ),
        (explain(), "could not be tested: this log has no node"),
        (explain(name="gyro_quantization"), "on the scatter of the samples; there is no sign of it"),
        (explain(build_round(BIAS, BIAS, CAMBER)), "gyro_bias (all) was added in round 1 and removed later"),
        (
            explain(build_round(None, BIAS)),
            "gained 20.0 in log-likelihood, too little to be more than chance",
        ),
        (explain(build_round(CAMBER, CAMBER, BIAS)), "round 1 but wheel_camber (right) explained it better"),
        (
            explain(
                build_round(CAMBER, CAMBER, BIAS),
                build_round(CAMBER, CAMBER, build_candidate("gyro_bias", gain=20.5)),
            ),
            "gyro_bias (all) gained 20.5 in log-likelihood in round 2 but",
        ),
        (
            explain(
                build_round(CAMBER, CAMBER, screened=[build_candidate("gyro_bias", gain=3.0, evidence=-0.5)])
            ),
            "gain 3.0 in log-likelihood (all), less than its free parameters cost (ln Bayes factor -0.5)",
        ),
        (
            explain(
                build_round(CAMBER, CAMBER, screened=[build_candidate("gyro_bias", gain=9.0, evidence=7.0)]),
                build_round(
                    CAMBER,
                    CAMBER,
                    screened=[
                        build_candidate("gyro_bias", "left", gain=5.0, evidence=1.0),
                        build_candidate("gyro_bias", "right", gain=4.0, evidence=2.0),
                        build_candidate("gyro_bias", "right", gain=8.0, evidence=3.0),
                    ],
                ),
            ),
            "in the last round it would gain 4.0 in log-likelihood (right), less than others gain",
        ),
    ],
)
def test_the_summary_of_an_effect_follows_from_its_best_candidate(explanation, expected_text):
    assert expected_text in explanation.summary


def test_each_round_has_one_row_per_scope_with_the_effect_that_beat_it():
    screened = [
        build_candidate("gyro_bias", "left", gain=5.0),
        build_candidate("gyro_bias", gain=4.0),
        build_candidate("gyro_lag"),
    ]
    explanation = explain(
        build_round(CAMBER, CAMBER, BIAS, screened=screened),
        build_round(BIAS, BIAS),
        build_round(None, BIAS),
    )
    rows = [(row.round, row.scope, row.gain, row.probability, row.beaten_by) for row in explanation.rows]
    assert rows == [
        (1, "all", 20.0, 0.25, "wheel_camber (right)"),
        (1, "left", 5.0, None, "wheel_camber (right)"),
        (2, "all", 20.0, 0.25, ""),
        (3, "all", 20.0, 0.25, "no effect was significant"),
    ]


def test_an_objection_is_stated_instead_of_a_probability():
    def hypothesis(objection, gain):
        term = ModelTerm(BY_NAME["lever_arm"](), "left")
        return Hypothesis(term, gain, -50.0, 0.0, objection=objection)

    judged = SimpleNamespace(hypotheses=[hypothesis("not physical: z = -0.1 m at its limit", 812.3)])
    assert _find_objection([judged], "lever_arm") == (
        "lever_arm (left) would gain 812.3 in log-likelihood, but is not physical: z = -0.1 m at its limit"
    )
    supported = SimpleNamespace(hypotheses=[hypothesis("", 900.0)])
    assert _find_objection([judged, supported], "lever_arm") == ""
    assert _find_objection([judged], "gyro_bias") == ""
