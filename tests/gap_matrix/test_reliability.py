"""Confidence: the tool that measures it against answers whose worth is known, and a few logs of each kind."""

import numpy as np
import pytest

from gap_matrix.judge import reliability, resumed, trials
from gap_matrix.judge.calibration import Given, binned, diagram
from gap_matrix.judge.trial_rows import judged

FIRST = reliability.FIRST["development"]


def test_bins_hold_each_name_once_and_their_intervals_the_true_share():
    rng = np.random.default_rng(5)
    given = [Given(c, bool(rng.random() < c)) for c in rng.uniform(0.0, 1.0, 4000)] + [Given(1.0, True)]
    bins = binned(given)
    assert sum(it.count for it in bins) == 4001
    assert bins[-1].high == 1.0 and bins[-1].right == sum(it.right for it in given if it.confidence >= 0.999)
    print([it.words for it in bins])
    assert all(it.interval[0] <= it.mean <= it.interval[1] for it in bins)


def test_who_is_always_sure_is_shown_below_what_it_says(tmp_path):
    bins = binned([Given(0.95, k % 2 == 0) for k in range(100)])
    assert len(bins) == 1 and bins[0].share == 0.5 and bins[0].interval[1] < 0.9
    for name in ("bins.svg", "bins.png"):
        diagram(bins, "half of them", tmp_path / name)
        assert (tmp_path / name).stat().st_size > 1000


def test_a_run_that_was_cut_off_makes_only_what_it_lacks(tmp_path):
    made = []

    def make(item):
        made.append(item)
        return {"key": str(item), "value": item**2}

    path = tmp_path / "rows.jsonl"
    assert [row["value"] for row in resumed.rows(path, [1, 2, 3], str, make, jobs=1)] == [1, 4, 9]
    path.write_text(path.read_text("utf-8")[:-5], "utf-8")
    assert [row["value"] for row in resumed.rows(path, [1, 2, 3, 4], str, make, jobs=1)] == [1, 4, 9, 16]
    assert made == [1, 2, 3, 3, 4]


def test_the_first_trials_are_mixed_as_all_are():
    few, many = trials.kinds(100), trials.kinds(2000)
    assert many[:100] == few
    assert {kind: few.count(kind) for kind in trials.MIX} == trials.MIX


def test_an_effect_of_both_wheels_is_worth_what_the_other_wheel_shows_of_it():
    made = next(it for it in map(trials.trial, range(FIRST, FIRST + 99), ["single"] * 99) if _of_both(it))
    (effect,) = made.hidden
    whole = made.meter.gain(effect)
    assert made.lost(effect, "left") + made.lost(effect, "right") == pytest.approx(whole)
    assert made.lost(effect, "all") == 0.0


def _of_both(made):
    return made.hidden[0].scope == "all"


@pytest.mark.parametrize("kind", [kind for kind in trials.MIX if kind != "pair"])
def test_a_name_that_is_given_as_sure_is_right(kind):
    """The first drive of each kind; of those that cannot tell the second, on which a name is given."""
    rows = [judged((FIRST + (kind == "blunt"), kind))]
    print(reliability.told(rows), reliability.wrong(rows, 0.0), sep="\n")
    assert not any("error" in row for row in rows)
    assert all(it.right for it in reliability.given(rows) if it.confidence > 0.99)
