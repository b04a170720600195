"""A real wheelchair, driven by nothing but its own gyros: what a model without effects lacks first."""

import pytest

import wanted
from gap_runs import wheelchair_model
from hubodo.gap.judge.round import judge_round
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.residual import compute_gap
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model
from hubodo.recording import Recording, Table

# Samples that are kept: 100 Hz are as good as 400 for what leans, and four times as fast.
EVERY = 4


@pytest.fixture(scope="module")
def first_round(tmp_path_factory):
    read = read_folder(wanted.recording("wheelchair"))
    thin = {
        name: Table({column: values[::EVERY] for column, values in table.columns.items()})
        for name, table in read.nodes.items()
    }
    path = tmp_path_factory.mktemp("wheelchair") / "model.toml"
    path.write_text(wheelchair_model(0.92), "utf-8")
    state, _ = track_wheel_phase(build_initial_state(build_problem(Recording(thin), read_model(path))))
    return judge_round(Evaluation(state, estimate_weights(state)))


def test_the_wheels_of_a_sports_wheelchair_lean(first_round):
    """Such chairs are built with 15 to 20 degrees of camber; both wheels of one chair have the same."""
    made = first_round
    assert made.best is not None
    assert made.best.key == ("wheel_camber", "all")
    assert made.best.probability > 0.99
    assert 0.26 < made.best.term.effect.values()["angle"] < 0.36


def test_with_that_the_gap_is_little_more_than_half(first_round):
    before = first_round.evaluation
    assert compute_gap(before.with_state(first_round.best.state).residuals) < 0.6 * compute_gap(
        before.residuals
    )
