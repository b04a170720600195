"""A search that is stopped leaves what it has found, and goes on from there to the same end."""

import json
import shutil
from contextlib import contextmanager
from dataclasses import dataclass, replace

import pytest

from gap_matrix.make_case import make
from gap_runs import Run, changed_model, gap
from gap_schema import check
from hubodo.cli import main
from hubodo.gap.judge import journal
from hubodo.gap.judge.round import judge_round
from hubodo.verbs import gap as verb

SEED = 4
HIDDEN = ("wheel_camber", "gyro_bias")
WORDS = ("--explain", "gyro_lag")
LEFT = ("gap.json", "model.toml", "report.html", "unfinished.jsonl")


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A folder in which two effects are hidden."""
    folder = tmp_path_factory.mktemp("two")
    make(folder, SEED, list(HIDDEN), "strong", scope="left", duration=40.0, rate_hz=30.0)
    return folder


@dataclass(frozen=True)
class Whole:
    """The run that nobody stopped, and the steps that it said: what is tried, how far it is."""

    run: Run
    said: list[tuple[str, float]]


@pytest.fixture(scope="module")
def whole(case, tmp_path_factory):
    said = []

    @contextmanager
    def listening():
        yield lambda words, share: said.append((words, share))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verb, "progress_line", listening)
        folder = tmp_path_factory.mktemp("whole") / "out"
        return Whole(gap(folder, case / "model.toml", case, *WORDS), said)


class Rounds(list):
    """The rounds that are judged; `stop_at` is the number of the one in which ctrl-C comes."""

    stop_at = None

    def __call__(self, *arguments):
        self.append(arguments)
        if len(self) == self.stop_at:
            raise KeyboardInterrupt
        return judge_round(*arguments)


@pytest.fixture
def rounds(monkeypatch):
    """Those of a run that nobody stops."""
    seen = Rounds()
    monkeypatch.setattr(journal, "judge_round", seen)
    return seen


@pytest.fixture(scope="module")
def stopped(case, tmp_path_factory):
    """Runs that were stopped in a round, each made once; what one left lies in the folder that is given."""
    made = {}

    def run(stop_at, folder):
        if stop_at not in made:
            seen = Rounds()
            seen.stop_at = stop_at
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(journal, "judge_round", seen)
                kept = tmp_path_factory.mktemp("stopped") / "out"
                made[stop_at] = gap(kept, case / "model.toml", case, *WORDS)
        if made[stop_at].folder.exists():
            shutil.copytree(made[stop_at].folder, folder)
        return replace(made[stop_at], folder=folder)

    return run


def names(run):
    return sorted(name for name, _ in run.names)


def test_a_search_that_is_stopped_leaves_what_it_found_and_says_so(stopped, tmp_path):
    left = stopped(2, tmp_path / "out")
    assert left.code == 130
    assert "holds the intermediate result; --resume continues" in left.err
    assert left.err.count("\n") == 1
    assert sorted(path.name for path in left.folder.iterdir()) == sorted(LEFT)
    check(left.result)
    assert left.result["finished"] is False
    assert len(left.names) == 1 and left.names[0][0] in HIDDEN
    assert any("interrupted" in line for line in left.result["warnings"])
    assert left.names[0][0] in (left.folder / "model.toml").read_text("utf-8")
    assert "interrupted" in (left.folder / "report.html").read_text("utf-8")


def test_a_search_that_is_stopped_before_it_found_anything_leaves_nothing(stopped, tmp_path):
    left = stopped(1, tmp_path / "out")
    assert left.code == 130
    assert not left.folder.exists()


def test_with_resume_it_ends_as_if_it_had_never_been_stopped(case, whole, stopped, rounds, tmp_path):
    first = stopped(4, tmp_path / "out")
    assert first.code == 130
    found = names(first)
    made = gap(tmp_path / "out", case / "model.toml", case, *WORDS, "--resume")
    assert made.code == 0, made.err
    assert made.result == whole.run.result
    assert names(made) == sorted(HIDDEN)
    assert made.out.replace(str(made.folder), "") == whole.run.out.replace(str(whole.run.folder), "")
    assert not (made.folder / "unfinished.jsonl").exists()
    # None of the whole rounds was judged again: the one that was stopped comes first.
    assert len(rounds[0][0].state.terms) == 1
    assert rounds[0][0].state.terms[0].effect.name in found


def test_a_file_that_a_kill_cut_off_gives_the_whole_rounds_in_it(case, whole, stopped, rounds, tmp_path):
    path = stopped(4, tmp_path / "out").folder / "unfinished.jsonl"
    head, first, second, *_ = path.read_text("utf-8").splitlines()
    path.write_text(f"{head}\n{first}\n{second[: len(second) // 2]}", "utf-8")
    made = gap(tmp_path / "out", case / "model.toml", case, *WORDS, "--resume")
    assert made.result == whole.run.result
    # The second was judged again; it begins where the first one's effect was added.
    assert len(rounds[0][0].state.terms) == 1


def test_another_model_or_other_options_are_refused(case, stopped, tmp_path):
    unfinished = stopped(2, tmp_path / "out").folder / "unfinished.jsonl"
    before = unfinished.read_bytes()
    other = changed_model(case, tmp_path / "other.toml", ("track_width = 0.", "track_width = 1."))
    for model, words in ((other, ()), (case / "model.toml", ("--reject", "gyro_lag"))):
        refused = gap(tmp_path / "out", model, case, *WORDS, *words, "--resume")
        assert refused.code == 2
        assert "is of another log, model, choice of options or version of hubodo" in refused.err
    assert unfinished.read_bytes() == before


def test_a_comparison_of_two_logs_is_not_resumed(case, tmp_path):
    both = ("--after", str(case), "-o", str(tmp_path / "out"), "--resume")
    assert main(["gap", str(case / "model.toml"), "--before", str(case), *both]) == 2


def test_without_a_search_to_go_on_with_resume_is_refused(case, tmp_path):
    refused = gap(tmp_path / "out", case / "model.toml", case, "--resume")
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "contains no interrupted search; leave out --resume" in refused.err
    assert not refused.folder.exists()


def test_each_step_says_what_is_tried_and_how_far_it_is(whole):
    assert whole.run.code == 0
    words = [text for text, _ in whole.said]
    assert "round 1: every effect in every scope" in words
    assert any(text.startswith("round 1: wheel_camber (") for text in words)
    assert "reconsidering wheel_camber (left)" in words
    searched = [
        share for text, share in whole.said if text.startswith(("round", "reconsidering", "measuring"))
    ]
    assert searched == sorted(searched)
    assert all(0.0 <= share <= 1.0 for _, share in whole.said)
    assert json.loads((whole.run.folder / "gap.json").read_text("utf-8"))["finished"] is True
