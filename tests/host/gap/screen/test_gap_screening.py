"""Score tests of all candidates from one linearisation."""

from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.screen.screening import screen_candidates
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model


def test_a_strong_hidden_effect_comes_first(camber_case):
    folder, hidden = camber_case
    problem = build_problem(read_folder(folder), read_model(folder / "model.toml"))
    state, _ = track_wheel_phase(build_initial_state(problem))
    best = screen_candidates(Evaluation(state, estimate_weights(state))).candidates[0]
    assert best.candidate.term.key == (hidden.name, hidden.scope)
    assert best.gain > 100.0 and best.evidence > 50.0
