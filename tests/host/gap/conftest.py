"""Cases shared by the tests of this folder: a cambered wheel, and a log without hidden effects; 60 s each."""

import pytest

from gap_matrix.make_case import make
from gap_runs import gap
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model

SEED = 3


@pytest.fixture(scope="session")
def camber(tmp_path_factory):
    """Return a folder and the effect hidden in it: camber of the right wheel by some millirad."""
    folder = tmp_path_factory.mktemp("camber")
    return folder, make(folder, SEED, ["wheel_camber"], "strong", scope="right", duration=60.0, rate_hz=50.0)[
        0
    ]


@pytest.fixture(scope="session")
def named(camber, tmp_path_factory):
    """Run the verb on the case with camber."""
    folder, _ = camber
    return gap(tmp_path_factory.mktemp("named") / "out", folder / "model.toml", folder)


@pytest.fixture(scope="session")
def nothing(tmp_path_factory):
    """Return a folder with a log without hidden effects."""
    folder = tmp_path_factory.mktemp("nothing")
    make(folder, SEED, [], duration=60.0, rate_hz=50.0, vibration=0.0)
    return folder


@pytest.fixture(scope="session")
def problem(nothing):
    """Return the problem of the log without hidden effects."""
    return build_problem(read_folder(nothing), read_model(nothing / "model.toml"))


@pytest.fixture(scope="session")
def evaluation(problem):
    """Return the evaluation of the model file's own effects, with tracked wheels."""
    state, _ = track_wheel_phase(build_initial_state(problem))
    return Evaluation(state, estimate_weights(state))
