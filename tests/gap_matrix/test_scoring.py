"""The scoring against answers whose worth is known: one that finds nothing, one that guesses, single rows."""

import json
from pathlib import Path

import numpy as np
import pytest

from gap_matrix import cases, dose, effects, matrix, outside
from gap_matrix.judge import score, tables
from gap_matrix.judge.cells import SEEDS, TABLES, Wanted, cells, pair_list
from gap_matrix.judge.diagnoses import AllBut, guess, silent


@pytest.fixture(scope="module")
def meter():
    return dose.Meter(cases.setup(11, duration=60.0))


def found(effect, scope="left", confidence=1.0, alike=(), parameters=None, where=""):
    return {
        "effect": effect,
        "scope": scope,
        "confidence": confidence,
        "inseparable_from": list(alike),
        "parameters": parameters or {},
        "where": where,
        "runner_up": None,
        "held_out_gap": {"before": 1.0, "after": 1.0},
    }


def answer(*entries, remaining=()):
    verdict = "explained" if entries else "no_gap"
    return {"verdict": verdict, "found": list(entries), "remaining": list(remaining)}


def truth(*names, **parameters):
    return {"effects": [{"name": name, "scope": "left", "parameters": parameters} for name in names]}


def row(table, name, variant, result, true):
    result = {**result, "held_out_gap": {"before": 1.2, "after": 1.0}}
    made = {"key": f"{table}/{name}", "table": table, "name": name, "variant": variant, "seconds": 1.0}
    return {**made, "result": result, "truth": true, "oracle": {"held_out_gap": result["held_out_gap"]}}


def test_who_finds_nothing_has_no_false_alarm_and_names_nothing(tmp_path):
    result = silent(tmp_path)
    assert score.first(result) == "nothing"
    assert score.exact(result, truth()) and not score.exact(result, truth("gyro_bias"))
    assert score.jaccard(result, truth()) == 1.0 and score.jaccard(result, truth("gyro_bias")) == 0.0
    rows = [row("nulls", "nothing", "drive", result, truth()) for _ in range(20)]
    rows += [row("singles", name, "strong", result, truth(name)) for name in effects.KINDS]
    nulls, singles = sorted(tables.all_tables(rows))
    assert "false alarms 0/20 0.0 % (0.0..16.8)" in nulls
    count = len(effects.KINDS)
    assert f"named first                 0/{count} 0.0 %" in singles
    assert f"nothing named               {count}/{count}" in singles


def test_a_guess_is_right_about_once_per_number_of_effects_and_always_sure_when_wrong(tmp_path):
    rng = np.random.default_rng(1)
    right = wrong = 0
    count = 20 * len(effects.KINDS)
    for k in range(count):
        (tmp_path / "left.csv").write_text(str(k))
        true = truth(str(rng.choice(list(effects.KINDS))))
        result = guess(tmp_path)
        right += score.named_first(result, true)
        wrong += bool(score.sure_and_wrong(result, true))
    assert right + wrong == count
    assert 6 <= right <= 38  # 20 expected, four sigma


def test_a_name_is_wrong_and_sure_only_above_the_limit_and_when_the_truth_is_not_beside_it():
    true = truth("wheel_camber")
    for entry, bad in [
        (found("track_width", confidence=0.91), True),
        (found("track_width", confidence=0.9), False),
        (found("track_width", confidence=0.95, alike=["wheel_camber"]), False),
        (found("empirical:left.gz ~ cos(theta)"), False),
        (found("wheel_camber"), False),
    ]:
        assert bool(score.sure_and_wrong(answer(entry), true)) == bad
    assert score.sure_and_wrong(answer(found("wheel_camber"), found("gyro_lag")), true) == ["gyro_lag"]


def test_both_of_a_pair_in_any_order_and_nothing_else_is_exact():
    true = truth("gyro_bias", "wheel_slip")
    assert score.exact(answer(found("wheel_slip"), found("gyro_bias", "all")), true)
    assert not score.exact(answer(found("wheel_slip")), true)
    three = answer(found("wheel_slip"), found("gyro_bias"), found("gyro_lag"))
    assert not score.exact(three, true) and score.jaccard(three, true) == pytest.approx(2 / 3)


def test_deviations_wrap_angles_and_leave_out_what_has_no_sigma():
    true = truth("wheel_eccentricity", amplitude=0.005, phase=3.1)
    values = {
        "amplitude": {"value": 0.006, "sigma": 0.0005},
        "phase": {"value": -3.1, "sigma": 0.04},
    }
    made, skipped = score.deviations(answer(found("wheel_eccentricity", parameters=values)), true)
    assert made == pytest.approx([2.0, (2 * np.pi - 6.2) / 0.04]) and skipped == 0
    values["phase"] = {"value": 0.0, "sigma": None}
    made, skipped = score.deviations(answer(found("wheel_eccentricity", parameters=values)), true)
    assert made == pytest.approx([2.0]) and skipped == 1
    assert score.deviations(answer(found("wheel_eccentricity", "right", parameters=values)), true) == ([], 0)


def test_the_gap_closed_is_relative_to_the_oracle_and_absent_where_that_closes_nothing():
    oracle = {"before": 2.0, "after": 1.0}
    assert score.closed({"before": 2.0, "after": 1.25}, oracle) == pytest.approx(0.75)
    assert score.closed({"before": 2.0, "after": 2.5}, oracle) == pytest.approx(-0.5)
    assert score.closed({"before": 2.0, "after": 1.0}, {"before": 1.0, "after": 1.00001}) is None


def test_a_description_needs_the_channel_and_then_the_dependence():
    true = {"effects": [], "outside": {"channels": ["left.gx"], "words": ["revolution", "hz"]}}
    left = {"channel": "left.gx", "where": "all the time", "looks_like": "once per revolution"}
    assert score.described(answer(remaining=[left]), true) == (True, True)
    assert score.described(answer(remaining=[{**left, "looks_like": "a step"}]), true) == (True, False)
    assert score.described(answer(remaining=[{**left, "channel": "right.gx"}]), true) == (False, False)
    for name, scope, right in [
        ("empirical:left.gx ~ sin(w t)", "left", True),
        ("empirical:gx ~ sin(w t)", "all", True),
        ("empirical:gx ~ sin(w t)", "right", False),
        ("empirical:right.gx ~ sin(w t)", "left", False),
    ]:
        term = found(name, scope, where="a line at 12.5 Hz")
        assert score.described(answer(term), true) == (right, right)
    assert score.described(answer(found("gyro_bias", where="left.gx, once per revolution")), true) == (
        False,
        False,
    )


def test_doubt_is_admitted_by_naming_both_or_by_little_confidence():
    true = {**truth("wheel_radius"), "other": "gyro_scale_factor"}
    assert score.admits_doubt(answer(found("gyro_scale_factor", alike=["wheel_radius"])), true)
    assert score.admits_doubt(answer(found("gyro_scale_factor", confidence=0.6)), true)
    assert not score.admits_doubt(answer(found("wheel_radius")), true)
    assert score.in_the_set(answer(found("gyro_scale_factor", alike=["wheel_radius"])), true)
    assert not score.in_the_set(answer(found("gyro_scale_factor")), true)


def test_everything_but_one_name_holds_names_nobody_listed():
    but = AllBut(["wheel_camber"])
    assert "wheel_camber" not in but and "gyro_bias" in but and "empirical:left.gz ~ 1" in but
    assert set(but) == set(effects.KINDS) - {"wheel_camber"}


def test_cells_have_keys_of_their_own_and_keep_to_their_seeds():
    for seeds, known in SEEDS.items():
        plan = cells(Wanted(seeds=seeds))
        assert len({cell.key for cell in plan}) == len(plan)
        assert {cell.table for cell in plan} == set(TABLES)
        assert all(seed in known for cell in plan for seed in cell.seeds)
    assert pair_list(40)[:8] == pair_list(8)
    assert len({frozenset(name for name, _ in pair) for pair in pair_list(40)}) == 40


def test_a_run_that_was_interrupted_goes_on_where_it_was(tmp_path, capsys):
    options = ["--tables", "nulls", "--diagnosis", "silent", "--jobs", "1", "-o", str(tmp_path)]
    matrix.main([*options, "--nulls", "1"])
    (path,) = Path(tmp_path).glob("*.jsonl")
    with path.open("a") as file:
        file.write('{"key": "nulls/nothing/dri')
    matrix.main([*options, "--nulls", "2", "--progress"])
    assert "2 cells, development seeds 0..999" in capsys.readouterr().out
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert [row["drive"] for row in rows] == [0, 1]


@pytest.mark.parametrize("name", outside.KINDS)
def test_what_is_outside_has_its_dose_on_one_node_in_the_channels_it_says(name, meter):
    setup = meter.setup
    hidden = outside.hide(setup, name, "strong", meter)
    if name == "bit_error":
        assert np.count_nonzero(hidden.added) == outside.BIT_ERRORS["strong"]
    else:
        assert hidden.gain == pytest.approx(dose.STRONG, rel=1e-6)
    assert hidden.channels and all(channel.startswith(hidden.node) for channel in hidden.channels)
    made = outside.records(setup, hidden)
    for node in effects.SIDES:
        difference = made[node].values - cases.record(setup, node, []).values
        assert np.any(difference) == (node == hidden.node)
