"""First round of the search on a recording of a sports wheelchair whose only inputs are its own gyros."""

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

# From 400 to 100 Hz: camber shows as well in the decimated log, and the test takes a quarter of the time.
DECIMATION = 4


@pytest.fixture(scope="module")
def first_round(tmp_path_factory):
    log = read_folder(wanted.recording("wheelchair"))
    decimated = {
        name: Table({column: values[::DECIMATION] for column, values in table.columns.items()})
        for name, table in log.nodes.items()
    }
    path = tmp_path_factory.mktemp("wheelchair") / "model.toml"
    path.write_text(wheelchair_model(0.92), "utf-8")
    state, _ = track_wheel_phase(build_initial_state(build_problem(Recording(decimated), read_model(path))))
    return judge_round(Evaluation(state, estimate_weights(state)))


def test_camber_of_a_sports_wheelchair_is_found(first_round):
    """Sports wheelchairs have 15 to 20 degrees of camber, the same on both wheels."""
    assert first_round.best is not None
    assert first_round.best.key == ("wheel_camber", "all")
    assert first_round.best.probability > 0.99
    assert 0.26 < first_round.best.term.effect.values()["angle"] < 0.36


def test_camber_reduces_the_gap_by_more_than_two_fifths(first_round):
    before = first_round.evaluation
    after = before.with_state(first_round.best.state)
    assert compute_gap(after.residuals) < 0.6 * compute_gap(before.residuals)
