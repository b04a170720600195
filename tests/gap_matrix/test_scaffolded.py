"""Scaffolding of effects outside the vocabulary: the formula is correct and found by the next run."""

import io
import json
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from gap_matrix.judge.scaffolded import Score, run_case, write_hidden_case
from gap_matrix.make_case import write_case
from gap_runs import run_gap
from hubodo.cli import main
from repetitions import first_and_more

# The shortest drive of the generator at a third of the usual rate: the gain in nats is the same, the search
# is faster.
SEED, NATS, DURATION, RATE_HZ = 20, 2000.0, 33.0, 30.0


pytestmark = pytest.mark.usefixtures("restore_effects_after_each")


@pytest.mark.repeat  # with one more effect than the test of the verb below
@pytest.mark.parametrize("name", ["steered_wheel", "cross_talk"])
def test_an_effect_outside_the_vocabulary_is_scaffolded_and_found_again_by_its_name(name):
    """`make gap-beyond` has eight effects."""
    score = Score()
    run_case(score, name, SEED, NATS, DURATION, RATE_HZ)
    assert (score.n_named, score.n_found_again) == (1, 1), score
    # Of correct estimates with Gaussian errors, one in 370 exceeds 3 sigma.
    assert max(map(abs, score.normalised_errors)) < 3.0, score.normalised_errors


@pytest.fixture(scope="module")
def bent_axle_case(tmp_path_factory):
    """Return a case folder, its hidden effect, and the run that scaffolded it."""
    folder = tmp_path_factory.mktemp("bent")
    case = folder / "case"
    truth = write_hidden_case(case, "bent_axle", SEED, NATS, DURATION, RATE_HZ)
    return case, truth, run_gap(folder / "out", case / "model.toml", case, "--scaffold", "bent_axle")


def test_the_verb_writes_a_class_that_the_next_runs_load(bent_axle_case, tmp_path):
    case, truth, first_run = bent_axle_case
    assert first_run.code == 0, first_run.err
    source = first_run.folder / "bent_axle.py"
    second_run = run_gap(tmp_path / "again", case / "model.toml", case, "--effects", str(source))
    assert second_run.names == [("bent_axle", truth.node)]
    for name, value in second_run.result["found"][0]["parameters"].items():
        assert abs(value["value"] - truth.truth[name]) < 3.0 * value["sigma"], name
    model_text = (second_run.folder / "model.toml").read_text("utf-8")
    assert f"[nodes.{truth.node}.effects.bent_axle]" in model_text
    out = io.StringIO()
    arguments = ["--effects", str(source), "--duration", "20", "-o", str(tmp_path / "sim.mcap"), "--json"]
    with redirect_stdout(out):
        assert main(["simulate", str(second_run.folder / "model.toml"), *arguments]) == 0
    assert json.loads(out.getvalue())["effects"][truth.node] == ["bent_axle"]
    third_run = run_gap(tmp_path / "left", second_run.folder / "model.toml", case, "--effects", str(source))
    assert third_run.result["verdict"] == "no_gap"


def test_a_model_with_an_effect_that_is_not_loaded_is_refused_with_the_option(bent_axle_case, tmp_path):
    case, truth, _ = bent_axle_case
    model = tmp_path / "model.toml"
    text = (case / "model.toml").read_text("utf-8")
    model.write_text(f"{text}[nodes.{truth.node}.effects.bent_axle]\naz_cos = 0.001\n", "utf-8")
    err = io.StringIO()
    with redirect_stderr(err):
        assert main(["simulate", str(model), "-o", str(tmp_path / "sim.mcap")]) == 2
    assert "--effects" in err.getvalue()
    assert err.getvalue().count("\n") == 1


def test_the_written_file_contains_a_test_on_its_log(bent_axle_case):
    """The same test fails for an effect that has been made ineffective."""
    _, _, first_run = bent_axle_case
    source, broken_source = (first_run.folder / name for name in ("bent_axle.py", "broken_axle.py"))
    text = source.read_text("utf-8")
    broken_source.write_text(text.replace("chain.spin**2", "0.0 * chain.spin"), "utf-8")
    arguments = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "-rA",
        "--rootdir",
        str(first_run.folder),
    ]
    process = subprocess.run(
        [*arguments, str(source), str(broken_source)],
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""},
        capture_output=True,
        text=True,
        timeout=300,
        cwd=first_run.folder,
    )
    outcomes = [line.partition("::")[0] for line in process.stdout.splitlines() if "::" in line]
    assert "PASSED bent_axle.py" in outcomes and "FAILED broken_axle.py" in outcomes, process.stdout
    assert "1 failed, 1 passed" in process.stdout, process.stdout


def test_the_written_file_passes_ruff(bent_axle_case):
    _, _, first_run = bent_axle_case
    ruff = Path(sys.executable).with_name("ruff")
    source = str(first_run.folder / "bent_axle.py")
    process = subprocess.run([ruff, "check", "--isolated", "--line-length", "110", "--select", "E,F", source])
    assert process.returncode == 0


@pytest.mark.parametrize(
    "hidden",
    first_and_more(["gyro_nonorthogonality"], [], ["lever_arm"], ["node_misalignment"], ["clock_skew"]),
    ids=" ".join,
)
def test_scaffolding_fails_if_the_vocabulary_explains_the_log(hidden, tmp_path):
    case = tmp_path / "case"
    write_case(case, SEED, hidden, "strong", duration=DURATION, rate_hz=RATE_HZ)
    process = run_gap(tmp_path / "out", case / "model.toml", case, "--scaffold", "ghost")
    assert process.code == 1
    assert "no new effect is needed" in process.out
    assert not (process.folder / "ghost.py").exists()
