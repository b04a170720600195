"""A refit: by how much the scatter of blocks tempers a gain, and weights that agree with what was fitted."""

from types import SimpleNamespace

import numpy as np

from gap_matrix.make_case import make
from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.refit import refit
from hubodo.gap.refit.refit import Refit, fit_tracked, refit_with_weights
from hubodo.gap.state.terms import ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model


def tempering(score):
    """Of a fit of one coordinate with unit information in all."""
    return Refit.tempering.fget(SimpleNamespace(covariance=np.eye(1), block_scores=score))


def test_independent_blocks_hardly_temper_a_gain_and_alike_ones_do():
    rng = np.random.default_rng(1)
    alone = [tempering(rng.standard_normal((15, 1)) / np.sqrt(15.0)) for _ in range(400)]
    beyond = float(np.mean(np.array(alone) > 1.0))
    print(f"seed 1, 400 fits of 15 blocks: mean {np.mean(alone):.3f}, above 1 in {beyond:.2f}")
    assert np.mean(alone) < 1.1
    assert 0.05 < beyond < 0.3
    together = [tempering(3.0 * rng.standard_normal((60, 1)) / np.sqrt(60.0)) for _ in range(400)]
    assert 6.0 < np.median(together) < 9.5


def test_what_moves_a_wheel_rightly_leaves_it_less_to_wander_and_the_fit_is_weighed_with_that(
    tmp_path, monkeypatch
):
    """A tyre that grows: without its size the wheel seems to wander hundreds of times as much."""
    seed = 3
    (hidden,) = make(tmp_path, seed, ["tyre_growth"], "strong", scope="right", duration=60.0, rate_hz=50.0)
    problem = build_problem(read_folder(tmp_path), read_model(tmp_path / "model.toml"))
    state = build_initial_state(problem).with_term(ModelTerm(BY_NAME["tyre_growth"](), "right"))
    tracked, _ = track_wheel_phase(state)
    once, fits = fit_tracked(Evaluation(tracked, estimate_weights(tracked))), []

    def counted(point):
        fits.append(point)
        return fit_tracked(point)

    monkeypatch.setattr(refit, "fit_tracked", counted)
    made = refit_with_weights(state)
    assert len(fits) == 2, "the second agrees"
    wanders = {}
    for name, fit in (("once", once), ("made", made)):
        _, walks = track_wheel_phase(fit.evaluation.state)
        wanders[name] = fit.evaluation.weights.wheel_walks["right"] / walks["right"]
    assert wanders["once"] > 100.0
    assert 0.9 < wanders["made"] < 1.1
    (growth,) = (term.effect.k for term in made.evaluation.state.terms if term.effect.name == "tyre_growth")
    sigma = np.sqrt(made.covariance[0, 0]) / np.sqrt(once.covariance[0, 0])
    assert sigma < 0.5, "what wanders less is known better"
    assert abs(growth / hidden.parameters["k"] - 1.0) < 0.05
