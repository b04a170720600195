"""Reliability of confidences: the evaluation against known answers, and one log of each kind of trial."""

import numpy as np
import pytest

from gap_matrix.judge import reliability, resumed, trials
from gap_matrix.judge.calibration import GivenName, bin_names, draw_diagram
from gap_matrix.judge.trial_rows import judge_trial
from repetitions import first_and_more

FIRST_SEED = reliability.FIRST_SEED["development"]


def test_bins_contain_each_name_once_and_their_intervals_the_true_share():
    rng = np.random.default_rng(5)
    names = [GivenName(c, bool(rng.random() < c)) for c in rng.uniform(0.0, 1.0, 4000)] + [
        GivenName(1.0, True)
    ]
    bins = bin_names(names)
    assert sum(it.count for it in bins) == 4001
    assert bins[-1].high == 1.0 and bins[-1].n_correct == sum(
        it.is_correct for it in names if it.confidence >= 0.999
    )
    print([it.describe() for it in bins])
    assert all(it.interval[0] <= it.mean <= it.interval[1] for it in bins)


def test_an_overconfident_diagnosis_has_a_share_below_its_confidence(tmp_path):
    bins = bin_names([GivenName(0.95, k % 2 == 0) for k in range(100)])
    assert len(bins) == 1 and bins[0].share == 0.5 and bins[0].interval[1] < 0.9
    for name in ("bins.svg", "bins.png"):
        draw_diagram(bins, "half of them", tmp_path / name)
        assert (tmp_path / name).stat().st_size > 1000


def test_an_interrupted_run_computes_only_the_missing_rows(tmp_path):
    calls = []

    def make(item):
        calls.append(item)
        return {"key": str(item), "value": item**2}

    path = tmp_path / "rows.jsonl"
    assert [row["value"] for row in resumed.compute_rows(path, [1, 2, 3], str, make, jobs=1)] == [1, 4, 9]
    path.write_text(path.read_text("utf-8")[:-5], "utf-8")
    assert [row["value"] for row in resumed.compute_rows(path, [1, 2, 3, 4], str, make, jobs=1)] == [
        1,
        4,
        9,
        16,
    ]
    assert calls == [1, 2, 3, 3, 4]


def test_the_first_trials_have_the_mix_of_all_trials():
    first_hundred, all_kinds = trials.mix_kinds(100), trials.mix_kinds(2000)
    assert all_kinds[:100] == first_hundred
    assert {kind: first_hundred.count(kind) for kind in trials.PERCENT_BY_KIND} == trials.PERCENT_BY_KIND


def test_the_advantage_of_both_wheels_over_one_is_the_gain_on_the_other_wheel():
    calls = next(
        it
        for it in map(trials.draw_trial, range(FIRST_SEED, FIRST_SEED + 99), ["single"] * 99)
        if _is_on_both_wheels(it)
    )
    (effect,) = calls.hidden
    total_gain = calls.meter.gain(effect)
    assert calls.scope_advantage(effect, "left") + calls.scope_advantage(effect, "right") == pytest.approx(
        total_gain
    )
    assert calls.scope_advantage(effect, "all") == 0.0


def _is_on_both_wheels(calls):
    return calls.hidden[0].scope == "all"


@pytest.mark.parametrize(
    "kind", ["null", *first_and_more("outside", "single", "blunt", "alike", "blunt alike")]
)
def test_names_with_a_confidence_above_99_percent_are_correct(kind):
    """The trial is the first of its kind; the second for `blunt`, as the first one gives no name.

    Pairs: `make gap-reliability`.
    """
    rows = [judge_trial((FIRST_SEED + (kind == "blunt"), kind))]
    print(reliability.format_table(rows), reliability.format_wrong_names(rows, 0.0), sep="\n")
    assert not any("error" in row for row in rows)
    assert all(it.is_correct for it in reliability.list_given_names(rows) if it.confidence > 0.99)
