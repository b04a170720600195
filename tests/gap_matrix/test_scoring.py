"""Scoring against known answers: a diagnosis that finds nothing, one that guesses, and single results."""

import json
from pathlib import Path

import numpy as np
import pytest

from gap_matrix import cases, dose, effects, matrix, outside
from gap_matrix.judge import score, tables
from gap_matrix.judge.cells import SEED_RANGES, TABLES, TableExtent, draw_pair_list, list_cells
from gap_matrix.judge.diagnoses import EverythingExcept, find_nothing, guess_effect


@pytest.fixture(scope="module")
def meter():
    return dose.GainMeter(cases.draw_setup(11, duration=60.0))


def build_finding(effect, scope="left", confidence=1.0, inseparable=(), parameters=None, where=""):
    return {
        "effect": effect,
        "scope": scope,
        "confidence": confidence,
        "inseparable_from": list(inseparable),
        "parameters": parameters or {},
        "where": where,
        "runner_up": None,
        "held_out_gap": {"before": 1.0, "after": 1.0},
    }


def build_result(*entries, remaining=()):
    verdict = "explained" if entries else "no_gap"
    return {"verdict": verdict, "found": list(entries), "remaining": list(remaining)}


def build_truth(*names, **parameters):
    return {"effects": [{"name": name, "scope": "left", "parameters": parameters} for name in names]}


def build_row(table, name, variant, result, truth_value):
    result = {**result, "held_out_gap": {"before": 1.2, "after": 1.0}}
    errors = {"key": f"{table}/{name}", "table": table, "name": name, "variant": variant, "seconds": 1.0}
    return {
        **errors,
        "result": result,
        "truth": truth_value,
        "oracle": {"held_out_gap": result["held_out_gap"]},
    }


def test_a_diagnosis_without_findings_has_no_false_alarm_and_no_name(tmp_path):
    result = find_nothing(tmp_path)
    assert score.first_name(result) == "nothing"
    assert score.is_exact(result, build_truth()) and not score.is_exact(result, build_truth("gyro_bias"))
    assert (
        score.jaccard(result, build_truth()) == 1.0 and score.jaccard(result, build_truth("gyro_bias")) == 0.0
    )
    rows = [build_row("nulls", "nothing", "drive", result, build_truth()) for _ in range(20)]
    rows += [build_row("singles", name, "strong", result, build_truth(name)) for name in effects.KINDS]
    nulls, singles = sorted(tables.format_tables(rows))
    assert "false alarms 0/20 0.0 % (0.0..16.8)" in nulls
    count = len(effects.KINDS)
    assert f"named first                 0/{count} 0.0 %" in singles
    assert f"nothing named               {count}/{count}" in singles


def test_a_random_guess_is_correct_once_in_the_number_of_effects_and_otherwise_confidently_wrong(tmp_path):
    rng = np.random.default_rng(1)
    n_correct = n_wrong = 0
    count = 20 * len(effects.KINDS)
    for k in range(count):
        (tmp_path / "left.csv").write_text(str(k))
        truth_value = build_truth(str(rng.choice(list(effects.KINDS))))
        result = guess_effect(tmp_path)
        n_correct += score.is_named_first(result, truth_value)
        n_wrong += bool(score.confident_wrong_names(result, truth_value))
    assert n_correct + n_wrong == count
    assert 6 <= n_correct <= 38  # 20 expected, four sigma


def test_a_confident_wrong_name_exceeds_the_threshold_and_is_not_inseparable_from_the_truth():
    truth_value = build_truth("wheel_camber")
    for entry, is_wrong in [
        (build_finding("track_width", confidence=0.91), True),
        (build_finding("track_width", confidence=0.9), False),
        (build_finding("track_width", confidence=0.95, inseparable=["wheel_camber"]), False),
        (build_finding("empirical:left.gz ~ cos(theta)"), False),
        (build_finding("wheel_camber"), False),
    ]:
        assert bool(score.confident_wrong_names(build_result(entry), truth_value)) == is_wrong
    assert score.confident_wrong_names(
        build_result(build_finding("wheel_camber"), build_finding("gyro_lag")), truth_value
    ) == ["gyro_lag"]


def test_a_result_with_both_hidden_effects_in_any_order_is_exact():
    truth_value = build_truth("gyro_bias", "wheel_slip")
    assert score.is_exact(
        build_result(build_finding("wheel_slip"), build_finding("gyro_bias", "all")), truth_value
    )
    assert not score.is_exact(build_result(build_finding("wheel_slip")), truth_value)
    three_findings = build_result(
        build_finding("wheel_slip"), build_finding("gyro_bias"), build_finding("gyro_lag")
    )
    assert not score.is_exact(three_findings, truth_value) and score.jaccard(
        three_findings, truth_value
    ) == pytest.approx(2 / 3)


def test_parameter_errors_wrap_angles_and_omit_estimates_without_sigma():
    truth_value = build_truth("wheel_eccentricity", amplitude=0.005, phase=3.1)
    values = {
        "amplitude": {"value": 0.006, "sigma": 0.0005},
        "phase": {"value": -3.1, "sigma": 0.04},
    }
    errors, skipped = score.parameter_errors(
        build_result(build_finding("wheel_eccentricity", parameters=values)), truth_value
    )
    assert errors == pytest.approx([2.0, (2 * np.pi - 6.2) / 0.04]) and skipped == 0
    values["phase"] = {"value": 0.0, "sigma": None}
    errors, skipped = score.parameter_errors(
        build_result(build_finding("wheel_eccentricity", parameters=values)), truth_value
    )
    assert errors == pytest.approx([2.0]) and skipped == 1
    assert score.parameter_errors(
        build_result(build_finding("wheel_eccentricity", "right", parameters=values)), truth_value
    ) == (
        [],
        0,
    )


def test_gap_closure_is_relative_to_the_oracle_and_none_if_that_closes_nothing():
    oracle = {"before": 2.0, "after": 1.0}
    assert score.gap_closure({"before": 2.0, "after": 1.25}, oracle) == pytest.approx(0.75)
    assert score.gap_closure({"before": 2.0, "after": 2.5}, oracle) == pytest.approx(-0.5)
    assert score.gap_closure({"before": 2.0, "after": 1.0}, {"before": 1.0, "after": 1.00001}) is None


def test_a_description_needs_the_channel_and_the_dependence():
    truth_value = {"effects": [], "outside": {"channels": ["left.gx"], "words": ["revolution", "hz"]}}
    residual = {"channel": "left.gx", "where": "all the time", "looks_like": "once per revolution"}
    assert score.matches_description(build_result(remaining=[residual]), truth_value) == (True, True)
    assert score.matches_description(
        build_result(remaining=[{**residual, "looks_like": "a step"}]), truth_value
    ) == (
        True,
        False,
    )
    assert score.matches_description(
        build_result(remaining=[{**residual, "channel": "right.gx"}]), truth_value
    ) == (
        False,
        False,
    )
    for name, scope, n_correct in [
        ("empirical:left.gx ~ sin(w t)", "left", True),
        ("empirical:gx ~ sin(w t)", "all", True),
        ("empirical:gx ~ sin(w t)", "right", False),
        ("empirical:right.gx ~ sin(w t)", "left", False),
    ]:
        term = build_finding(name, scope, where="a line at 12.5 Hz")
        assert score.matches_description(build_result(term), truth_value) == (n_correct, n_correct)
    assert score.matches_description(
        build_result(build_finding("gyro_bias", where="left.gx, once per revolution")), truth_value
    ) == (
        False,
        False,
    )


def test_ambiguity_is_admitted_by_naming_both_effects_or_by_low_confidence():
    truth_value = {**build_truth("wheel_radius"), "other": "gyro_scale_factor"}
    assert score.admits_ambiguity(
        build_result(build_finding("gyro_scale_factor", inseparable=["wheel_radius"])), truth_value
    )
    assert score.admits_ambiguity(
        build_result(build_finding("gyro_scale_factor", confidence=0.6)), truth_value
    )
    assert not score.admits_ambiguity(build_result(build_finding("wheel_radius")), truth_value)
    assert score.is_in_candidate_set(
        build_result(build_finding("gyro_scale_factor", inseparable=["wheel_radius"])), truth_value
    )
    assert not score.is_in_candidate_set(build_result(build_finding("gyro_scale_factor")), truth_value)


def test_everything_except_one_name_contains_unknown_names():
    names = EverythingExcept(["wheel_camber"])
    assert "wheel_camber" not in names and "gyro_bias" in names and "empirical:left.gz ~ 1" in names
    assert set(names) == set(effects.KINDS) - {"wheel_camber"}


def test_cells_have_unique_keys_and_seeds_of_their_range():
    for seeds, known in SEED_RANGES.items():
        plan = list_cells(TableExtent(seeds=seeds))
        assert len({cell.key for cell in plan}) == len(plan)
        assert {cell.table for cell in plan} == set(TABLES)
        assert all(seed in known for cell in plan for seed in cell.seeds)
    assert draw_pair_list(40)[:8] == draw_pair_list(8)
    assert len({frozenset(name for name, _ in pair) for pair in draw_pair_list(40)}) == 40


def test_an_interrupted_matrix_run_continues(tmp_path, capsys):
    options = ["--tables", "nulls", "--diagnosis", "silent", "--jobs", "1", "-o", str(tmp_path)]
    matrix.main([*options, "--nulls", "1"])
    (path,) = Path(tmp_path).glob("*.jsonl")
    with path.open("a") as file:
        file.write('{"key": "nulls/nothing/dri')
    matrix.main([*options, "--nulls", "2", "--progress"])
    assert "2 cells, development seeds 0..999" in capsys.readouterr().out
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert [build_row["drive"] for build_row in rows] == [0, 1]


@pytest.mark.parametrize("name", outside.KINDS)
def test_an_effect_outside_the_vocabulary_has_its_gain_on_one_node_in_its_channels(name, meter):
    setup = meter.setup
    hidden = outside.hide_effect(setup, name, "strong", meter)
    if name == "bit_error":
        assert np.count_nonzero(hidden.added) == outside.BIT_ERROR_COUNTS["strong"]
    else:
        assert hidden.gain == pytest.approx(dose.STRONG_NATS, rel=1e-6)
    assert hidden.channels and all(channel.startswith(hidden.node) for channel in hidden.channels)
    errors = outside.simulate_records(setup, hidden)
    for node in effects.SIDES:
        difference = errors[node].values - cases.simulate_node_record(setup, node, []).values
        assert np.any(difference) == (node == hidden.node)
