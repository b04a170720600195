"""Fixtures shared by the tests of this folder: logs of 40 s with and without a hidden effect."""

import pytest

from gap_matrix.make_case import write_case
from gap_runs import run_gap
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model
from shared_run import compute_once

SEED = 3


@pytest.fixture(scope="session")
def camber_case(tmp_path_factory):
    """Return the folder of a case and its hidden effect: a few millirad of camber of the right wheel."""

    def write(folder):
        case = ["wheel_camber"], "strong"
        (hidden,) = write_case(folder, SEED, *case, scope="right", duration=40.0, rate_hz=50.0)
        return folder, hidden

    return compute_once(tmp_path_factory, "camber-case", write)


@pytest.fixture(scope="session")
def camber_run(camber_case, tmp_path_factory):
    """Return the run of `hubodo gap` on the case with camber."""
    folder, _ = camber_case
    return compute_once(
        tmp_path_factory,
        "camber-run",
        lambda out: run_gap(out / "gap", folder / "model.toml", folder, page=True),
    )


@pytest.fixture(scope="session")
def clean_log(tmp_path_factory):
    """Return a folder with a log without hidden effects."""
    folder = tmp_path_factory.mktemp("clean_log")
    write_case(folder, SEED, [], duration=40.0, rate_hz=50.0, vibration=0.0)
    return folder


@pytest.fixture(scope="session")
def problem(clean_log):
    """Return the gap problem of the log without hidden effects."""
    return build_problem(read_folder(clean_log), read_model(clean_log / "model.toml"))


@pytest.fixture(scope="session")
def evaluation(problem):
    """Return the evaluation of the unchanged model on the clean log, with tracked wheel phases."""
    state, _ = track_wheel_phase(build_initial_state(problem))
    return Evaluation(state, estimate_weights(state))


@pytest.fixture(scope="session")
def long_evaluation(tmp_path_factory):
    """Return the evaluation of the unchanged model on a clean log of 160 s, with tracked wheel phases."""
    folder = tmp_path_factory.mktemp("long_log")
    write_case(folder, SEED, [], duration=160.0, rate_hz=50.0, vibration=0.0)
    problem = build_problem(read_folder(folder), read_model(folder / "model.toml"))
    state, _ = track_wheel_phase(build_initial_state(problem))
    return Evaluation(state, estimate_weights(state))
