"""An interrupted search writes its findings, and a resumed one ends with the same result."""

import json
import shutil
from contextlib import contextmanager
from dataclasses import dataclass, replace

import pytest

from gap_matrix.make_case import write_case
from gap_runs import Run, run_gap, write_changed_model
from gap_schema import validate_result
from hubodo.cli import main
from hubodo.gap.judge import journal
from hubodo.gap.judge.round import judge_round
from hubodo.verbs import gap as gap_verb

SEED = 4
HIDDEN = ("wheel_camber", "gyro_bias")
OPTIONS = ("--explain", "gyro_lag")
FILES_AFTER_INTERRUPT = ("gap.json", "model.toml", "report.html", "unfinished.jsonl")


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Return the folder of a case with two hidden effects."""
    folder = tmp_path_factory.mktemp("two")
    write_case(folder, SEED, list(HIDDEN), "strong", scope="left", duration=40.0, rate_hz=30.0)
    return folder


@dataclass(frozen=True)
class UninterruptedRun:
    """A run that was not interrupted, and its progress reports (text, share done)."""

    run: Run
    progress: list[tuple[str, float]]


@pytest.fixture(scope="module")
def uninterrupted(case, tmp_path_factory):
    progress = []

    @contextmanager
    def record_progress():
        yield lambda text, share: progress.append((text, share))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gap_verb, "progress_line", record_progress)
        folder = tmp_path_factory.mktemp("uninterrupted") / "out"
        return UninterruptedRun(run_gap(folder, case / "model.toml", case, *OPTIONS), progress)


class RoundRecorder(list):
    """A recorder of the arguments of each judged round; Ctrl-C arrives in round `stop_at`."""

    stop_at = None

    def __call__(self, *arguments):
        self.append(arguments)
        if len(self) == self.stop_at:
            raise KeyboardInterrupt
        return judge_round(*arguments)


@pytest.fixture
def judged_rounds(monkeypatch):
    """Return a recorder of the rounds judged in a run that is not interrupted."""
    recorder = RoundRecorder()
    monkeypatch.setattr(journal, "judge_round", recorder)
    return recorder


@pytest.fixture(scope="module")
def interrupt_run(case, tmp_path_factory):
    """Return a function that interrupts a run in a given round and copies its output to a folder.

    Each round is run once; further calls copy the same output.
    """
    runs = {}

    def interrupt_in_round(stop_at, folder):
        if stop_at not in runs:
            recorder = RoundRecorder()
            recorder.stop_at = stop_at
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(journal, "judge_round", recorder)
                output = tmp_path_factory.mktemp("interrupted") / "out"
                runs[stop_at] = run_gap(output, case / "model.toml", case, *OPTIONS, page=True)
        if runs[stop_at].folder.exists():
            shutil.copytree(runs[stop_at].folder, folder)
        return replace(runs[stop_at], folder=folder)

    return interrupt_in_round


def found_effects(run):
    return sorted(name for name, _ in run.names)


def test_an_interrupted_search_writes_its_findings_and_reports_the_interruption(interrupt_run, tmp_path):
    run = interrupt_run(2, tmp_path / "out")
    assert run.code == 130
    assert "holds the intermediate result; --resume continues" in run.err
    assert run.err.count("\n") == 1
    assert sorted(path.name for path in run.folder.iterdir()) == sorted(FILES_AFTER_INTERRUPT)
    validate_result(run.result)
    assert run.result["finished"] is False
    assert len(run.names) == 1 and run.names[0][0] in HIDDEN
    assert any("interrupted" in line for line in run.result["warnings"])
    assert run.names[0][0] in (run.folder / "model.toml").read_text("utf-8")
    assert "interrupted" in (run.folder / "report.html").read_text("utf-8")


def test_a_search_interrupted_before_its_first_finding_writes_nothing(interrupt_run, tmp_path):
    run = interrupt_run(1, tmp_path / "out")
    assert run.code == 130
    assert not run.folder.exists()


def test_a_resumed_search_ends_with_the_result_of_an_uninterrupted_one(
    case, uninterrupted, interrupt_run, judged_rounds, tmp_path
):
    effects_before = found_effects(interrupt_run(2, tmp_path / "out"))
    # The resumed search judges two rounds and is interrupted in the third one.
    judged_rounds.stop_at = 3
    interrupted = run_gap(tmp_path / "out", case / "model.toml", case, *OPTIONS, "--resume")
    assert interrupted.code == 130
    judged_rounds.stop_at = None
    resumed = run_gap(tmp_path / "out", case / "model.toml", case, *OPTIONS, "--resume")
    assert resumed.code == 0, resumed.err
    assert resumed.result == uninterrupted.run.result
    assert found_effects(resumed) == sorted(HIDDEN)
    assert resumed.out.replace(str(resumed.folder), "") == uninterrupted.run.out.replace(
        str(uninterrupted.run.folder), ""
    )
    assert not (resumed.folder / "unfinished.jsonl").exists()
    # No complete round is judged again: the first one judged is the interrupted one.
    assert len(judged_rounds[0][0].state.terms) == 1
    assert judged_rounds[0][0].state.terms[0].effect.name in effects_before
    assert len(judged_rounds[3][0].state.terms) == len(judged_rounds[2][0].state.terms)


@pytest.mark.repeat
def test_a_truncated_journal_restores_its_complete_rounds(
    case, uninterrupted, interrupt_run, judged_rounds, tmp_path
):
    path = interrupt_run(4, tmp_path / "out").folder / "unfinished.jsonl"
    head, first, second, *_ = path.read_text("utf-8").splitlines()
    path.write_text(f"{head}\n{first}\n{second[: len(second) // 2]}", "utf-8")
    resumed = run_gap(tmp_path / "out", case / "model.toml", case, *OPTIONS, "--resume")
    assert resumed.result == uninterrupted.run.result
    # Round 2 is judged again, and starts from the state that has the effect of round 1.
    assert len(judged_rounds[0][0].state.terms) == 1


def test_resuming_with_another_model_or_other_options_is_refused(case, interrupt_run, tmp_path):
    unfinished = interrupt_run(2, tmp_path / "out").folder / "unfinished.jsonl"
    before = unfinished.read_bytes()
    other = write_changed_model(case, tmp_path / "other.toml", ("track_width = 0.", "track_width = 1."))
    for model, options in ((other, ()), (case / "model.toml", ("--reject", "gyro_lag"))):
        run = run_gap(tmp_path / "out", model, case, *OPTIONS, *options, "--resume")
        assert run.code == 2
        assert "is of another log, model, choice of options or version of hubodo" in run.err
    assert unfinished.read_bytes() == before


def test_resuming_a_comparison_of_two_logs_is_refused(case, tmp_path):
    options = ("--after", str(case), "-o", str(tmp_path / "out"), "--resume")
    assert main(["gap", str(case / "model.toml"), "--before", str(case), *options]) == 2


def test_resuming_without_an_interrupted_search_is_refused(case, tmp_path):
    run = run_gap(tmp_path / "out", case / "model.toml", case, "--resume")
    assert (run.code, run.err.count("\n")) == (2, 1)
    assert "contains no interrupted search; leave out --resume" in run.err
    assert not run.folder.exists()


def test_progress_names_each_step_and_its_share_increases(uninterrupted):
    assert uninterrupted.run.code == 0
    steps = [text for text, _ in uninterrupted.progress]
    assert "round 1: every effect in every scope" in steps
    assert any(text.startswith("round 1: wheel_camber (") for text in steps)
    assert any(text.startswith("reconsidering ") for text in steps)
    search_shares = [
        share
        for text, share in uninterrupted.progress
        if text.startswith(("round", "reconsidering", "measuring"))
    ]
    assert search_shares == sorted(search_shares)
    assert all(0.0 <= share <= 1.0 for _, share in uninterrupted.progress)
    assert json.loads((uninterrupted.run.folder / "gap.json").read_text("utf-8"))["finished"] is True


def test_a_stored_round_of_steady_wheels_is_read_back_with_steady_wheels(evaluation, tmp_path):
    steady = evaluation.with_state(replace(evaluation.state, has_steady_wheels=True))
    refitted = [("wheel_radius", "left")]
    judged = journal.Journal(tmp_path / "rounds", "log").judge_round(steady, (), refitted)
    stored = journal.Journal(tmp_path / "rounds", "log", resume=True).judge_round(steady, (), refitted)
    for one in (judged, stored):
        assert one.find_hypothesis(refitted[0]).state.has_steady_wheels
