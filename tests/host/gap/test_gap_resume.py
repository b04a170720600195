"""A search that is stopped leaves what it has found, and goes on from there to the same end."""

import json

import pytest
from test_gap_json import check

from gap_matrix.make_case import make
from gap_runs import changed_model, gap
from hubodo.cli import main
from hubodo.gap.judge import journal
from hubodo.gap.judge.round import look

SEED = 4
HIDDEN = ("wheel_camber", "gyro_bias")
LEFT = ("gap.json", "model.toml", "report.html", "unfinished.jsonl")


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A folder in which two effects are hidden."""
    folder = tmp_path_factory.mktemp("two")
    make(folder, SEED, list(HIDDEN), "strong", scope="left", duration=40.0, rate_hz=50.0)
    return folder


@pytest.fixture(scope="module")
def whole(case, tmp_path_factory):
    """The run that nobody stopped."""
    return gap(tmp_path_factory.mktemp("whole") / "out", case / "model.toml", case, "--explain", "gyro_lag")


@pytest.fixture
def rounds(monkeypatch):
    """A list of the rounds that are judged; `stop_at` is the number of the one in which ctrl-C comes."""

    class Rounds(list):
        stop_at = None

    seen = Rounds()

    def watched(*arguments):
        seen.append(arguments)
        if len(seen) == seen.stop_at:
            raise KeyboardInterrupt
        return look(*arguments)

    monkeypatch.setattr(journal, "look", watched)
    return seen


def names(run):
    return sorted(name for name, _ in run.names)


def test_a_search_that_is_stopped_leaves_what_it_found_and_says_so(case, rounds, tmp_path):
    rounds.stop_at = 2
    stopped = gap(tmp_path / "out", case / "model.toml", case)
    assert stopped.code == 130
    assert "has what was found until then; --resume goes on" in stopped.err
    assert stopped.err.count("\n") == 1
    assert sorted(path.name for path in stopped.folder.iterdir()) == sorted(LEFT)
    check(stopped.result)
    assert stopped.result["finished"] is False
    assert len(stopped.names) == 1 and stopped.names[0][0] in HIDDEN
    assert any("stopped" in line for line in stopped.result["warnings"])
    assert stopped.names[0][0] in (stopped.folder / "model.toml").read_text("utf-8")
    assert "stopped" in (stopped.folder / "report.html").read_text("utf-8")


@pytest.mark.parametrize("stop_at", [1, 2, 4])
def test_with_resume_it_ends_as_if_it_had_never_been_stopped(case, whole, rounds, tmp_path, stop_at):
    rounds.stop_at = stop_at
    words = ("--explain", "gyro_lag")
    first = gap(tmp_path / "out", case / "model.toml", case, *words)
    assert first.code == 130
    if stop_at == 1:
        # Nothing was found yet: nothing is written, and there is nothing to go on with.
        assert not first.folder.exists()
        return
    rounds.clear()
    rounds.stop_at = None
    made = gap(tmp_path / "out", case / "model.toml", case, *words, "--resume")
    assert made.code == 0, made.err
    assert made.result == whole.result
    assert names(made) == sorted(HIDDEN)
    assert made.out.replace(str(made.folder), "") == whole.out.replace(str(whole.folder), "")
    assert not (made.folder / "unfinished.jsonl").exists()
    # None of the whole rounds was judged again: the one that was stopped comes first.
    assert len(rounds[0][0].state.terms) == 1
    assert rounds[0][0].state.terms[0].effect.name in names(first)


def test_a_file_that_a_kill_cut_off_gives_the_whole_rounds_in_it(case, whole, rounds, tmp_path):
    rounds.stop_at = 3
    gap(tmp_path / "out", case / "model.toml", case)
    path = tmp_path / "out" / "unfinished.jsonl"
    head, first, second = path.read_text("utf-8").splitlines()
    path.write_text(f"{head}\n{first}\n{second[: len(second) // 2]}", "utf-8")
    rounds.clear()
    rounds.stop_at = None
    made = gap(tmp_path / "out", case / "model.toml", case, "--resume")
    assert made.result == whole.result
    # The second was judged again; it begins where the first one's effect was added.
    assert len(rounds[0][0].state.terms) == 1


def test_another_model_or_other_options_are_refused(case, rounds, tmp_path):
    rounds.stop_at = 2
    gap(tmp_path / "out", case / "model.toml", case)
    rounds.stop_at = None
    before = (tmp_path / "out" / "unfinished.jsonl").read_bytes()
    other = changed_model(case, tmp_path / "other.toml", ("track_width = 0.", "track_width = 1."))
    for model, words in ((other, ()), (case / "model.toml", ("--reject", "gyro_lag"))):
        refused = gap(tmp_path / "out", model, case, *words, "--resume")
        assert refused.code == 2
        assert "is of another log, model, choice of options or version of hubodo" in refused.err
    assert (tmp_path / "out" / "unfinished.jsonl").read_bytes() == before


def test_a_comparison_of_two_logs_is_not_resumed(case, tmp_path):
    both = ("--after", str(case), "-o", str(tmp_path / "out"), "--resume")
    assert main(["gap", str(case / "model.toml"), "--before", str(case), *both]) == 2


def test_without_a_search_to_go_on_with_resume_is_refused(case, tmp_path):
    refused = gap(tmp_path / "out", case / "model.toml", case, "--resume")
    assert (refused.code, refused.err.count("\n")) == (2, 1)
    assert "no search was stopped there; leave out --resume" in refused.err
    assert not refused.folder.exists()


def test_each_step_says_what_is_tried_and_how_far_it_is(case, monkeypatch, tmp_path):
    from contextlib import contextmanager

    from hubodo.verbs import gap as verb

    said = []

    @contextmanager
    def listening():
        yield lambda words, share: said.append((words, share))

    monkeypatch.setattr(verb, "progress_line", listening)
    assert gap(tmp_path / "out", case / "model.toml", case).code == 0
    words = [text for text, _ in said]
    assert "round 1: every effect in every scope" in words
    assert any(text.startswith("round 1: wheel_camber (") for text in words)
    assert "reconsidering wheel_camber (left)" in words
    searched = [share for text, share in said if text.startswith(("round", "reconsidering", "measuring"))]
    assert searched == sorted(searched)
    assert all(0.0 <= share <= 1.0 for _, share in said)
    assert json.loads((tmp_path / "out" / "gap.json").read_text("utf-8"))["finished"] is True
