"""What no list has is given a name: the formula is the true one, and the next run finds it by that name."""

import io
import json
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from gap_matrix.judge.scaffolded import Score, hidden, scaffolded, tried
from gap_matrix.make_case import write_case
from gap_runs import run_gap
from hubodo.cli import main
from hubodo.effects import BY_NAME

# The shortest drive that the generator makes, at a third of the usual rate: as many nats show as much in less
# time.
SEED, NATS, SECONDS, RATE_HZ = 20, 2000.0, 33.0, 30.0


@pytest.fixture(autouse=True)
def the_list_as_it_was():
    """What a run has loaded is forgotten after it."""
    known = dict(BY_NAME)
    yield
    BY_NAME.clear()
    BY_NAME.update(known)


@pytest.mark.parametrize("name", ["steered_wheel", "road_camber", "slipping_clock", "cross_talk"])
def test_an_effect_that_nobody_listed_gets_its_formula_and_is_found_again_by_its_name(name):
    score = Score()
    tried(score, name, SEED, NATS, SECONDS, RATE_HZ)
    assert (score.named, score.again) == (1, 1), score
    # One in 370 of right values lies farther off.
    assert max(map(abs, score.pulls)) < 3.0, score.pulls


@pytest.mark.parametrize("listed", ["lever_arm", "gyro_nonorthogonality"])
def test_no_effect_is_made_of_a_log_that_the_list_explains(listed, tmp_path):
    write_case(tmp_path / "case", SEED, [listed], "strong", duration=SECONDS, rate_hz=RATE_HZ)
    assert scaffolded(tmp_path / "case", "nothing") is None


@pytest.fixture(scope="module")
def bent(tmp_path_factory):
    """(case, what is hidden, the run that gave it a name)."""
    folder = tmp_path_factory.mktemp("bent")
    case = folder / "case"
    truth = hidden(case, "bent_axle", SEED, NATS, SECONDS, RATE_HZ)
    return case, truth, run_gap(folder / "out", case / "model.toml", case, "--scaffold", "bent_axle")


def test_the_verb_writes_the_class_and_the_next_runs_know_it(bent, tmp_path):
    case, truth, first = bent
    assert first.code == 0, first.err
    written = first.folder / "bent_axle.py"
    again = run_gap(tmp_path / "again", case / "model.toml", case, "--effects", str(written))
    assert again.names == [("bent_axle", truth.node)]
    for name, value in again.result["found"][0]["parameters"].items():
        assert abs(value["value"] - truth.truth[name]) < 3.0 * value["sigma"], name
    found = (again.folder / "model.toml").read_text("utf-8")
    assert f"[nodes.{truth.node}.effects.bent_axle]" in found
    out = io.StringIO()
    words = ["--effects", str(written), "--duration", "20", "-o", str(tmp_path / "sim.mcap"), "--json"]
    with redirect_stdout(out):
        assert main(["simulate", str(again.folder / "model.toml"), *words]) == 0
    assert json.loads(out.getvalue())["effects"][truth.node] == ["bent_axle"]
    left = run_gap(tmp_path / "left", again.folder / "model.toml", case, "--effects", str(written))
    assert left.result["verdict"] == "no_gap"


def test_a_model_with_it_says_what_to_load(bent, tmp_path):
    case, truth, _ = bent
    model = tmp_path / "model.toml"
    text = (case / "model.toml").read_text("utf-8")
    model.write_text(f"{text}[nodes.{truth.node}.effects.bent_axle]\naz_cos = 0.001\n", "utf-8")
    err = io.StringIO()
    with redirect_stderr(err):
        assert main(["simulate", str(model), "-o", str(tmp_path / "sim.mcap")]) == 2
    assert "--effects" in err.getvalue()
    assert err.getvalue().count("\n") == 1


def test_the_written_file_is_tested_against_its_log_by_pytest(bent):
    """An effect that does nothing does not pass it."""
    _, _, first = bent
    written, broken = (first.folder / name for name in ("bent_axle.py", "broken_axle.py"))
    text = written.read_text("utf-8")
    broken.write_text(text.replace("chain.spin**2", "0.0 * chain.spin"), "utf-8")
    words = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-rA", "--rootdir", str(first.folder)]
    made = subprocess.run(
        [*words, str(written), str(broken)], capture_output=True, text=True, timeout=300, cwd=first.folder
    )
    told = [line.partition("::")[0] for line in made.stdout.splitlines() if "::" in line]
    assert "PASSED bent_axle.py" in told and "FAILED broken_axle.py" in told, made.stdout
    assert "1 failed, 1 passed" in made.stdout, made.stdout


def test_the_written_file_is_as_ruff_has_it(bent):
    _, _, first = bent
    ruff = Path(sys.executable).with_name("ruff")
    written = str(first.folder / "bent_axle.py")
    made = subprocess.run([ruff, "check", "--isolated", "--line-length", "110", "--select", "E,F", written])
    assert made.returncode == 0


def test_with_nothing_left_the_verb_says_so_and_fails(nothing_hidden, tmp_path):
    made = run_gap(tmp_path / "out", nothing_hidden / "model.toml", nothing_hidden, "--scaffold", "ghost")
    assert made.code == 1
    assert "no new effect is needed" in made.out
    assert not (made.folder / "ghost.py").exists()


@pytest.fixture
def nothing_hidden(tmp_path):
    write_case(tmp_path / "case", SEED, [], duration=SECONDS, rate_hz=RATE_HZ)
    return tmp_path / "case"
