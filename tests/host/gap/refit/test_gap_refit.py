"""Refit: reduction of a gain by the scatter of block scores, and weights consistent with the fit."""

import numpy as np
import pytest

from gap_matrix.make_case import write_case
from hubodo.effects import BY_NAME
from hubodo.gap.judge.search import build_initial_state
from hubodo.gap.problem.build import build_problem
from hubodo.gap.process_noise.evaluation import Evaluation
from hubodo.gap.process_noise.tracking import estimate_weights, track_wheel_phase
from hubodo.gap.refit import refit
from hubodo.gap.refit.prior import adopt_prior, build_prior
from hubodo.gap.refit.refit import fit_tracked, refit_with_weights
from hubodo.gap.refit.tempering import compute_tempering, measure_tempering
from hubodo.gap.state.terms import REPEATABILITY, ModelTerm
from hubodo.log.csv_folder import read_folder
from hubodo.model.model_file import read_model


def temper_one(score):
    """Return the tempering factor of a fit of one coordinate with unit information in total."""
    return compute_tempering(score.T @ score, np.eye(1), len(score))


def test_correlated_blocks_reduce_a_gain_and_independent_ones_hardly_do():
    rng = np.random.default_rng(1)
    independent = [temper_one(rng.standard_normal((15, 1)) / np.sqrt(15.0)) for _ in range(400)]
    share_above_one = float(np.mean(np.array(independent) > 1.0))
    print(f"seed 1, 400 fits of 15 blocks: mean {np.mean(independent):.3f}, above 1 in {share_above_one:.2f}")
    assert np.mean(independent) < 1.1
    assert 0.05 < share_above_one < 0.3
    dependent = [temper_one(3.0 * rng.standard_normal((60, 1)) / np.sqrt(60.0)) for _ in range(400)]
    assert 6.0 < np.median(dependent) < 9.5


def test_a_nuisance_that_is_nearly_collinear_with_an_effect_does_not_imitate_correlation():
    """Scores of independent blocks: the marginal variance counts, not the information times that variance."""
    rng, n_blocks = np.random.default_rng(2), 200
    information = np.array([[1.0, 0.9999], [0.9999, 1.0]])
    scores = rng.multivariate_normal([0.0, 0.0], information / n_blocks, n_blocks)
    covariance = np.linalg.inv(information)
    robust = covariance @ (scores.T @ scores) @ covariance
    own = np.s_[:1, :1]
    tempering = compute_tempering(robust[own], covariance[own], n_blocks)
    assert tempering < 1.2, "seed 2"
    assert scores[:, 0] @ scores[:, 0] * covariance[0, 0] > 1000.0


@pytest.mark.parametrize(
    ("unevenness", "is_whitened", "expected"), [(0.0, False, 1.0), (0.3, False, 3.5), (0.3, True, 1.0)]
)
def test_noise_of_uneven_level_is_tempered_though_scores_of_few_blocks_show_no_correlation(
    unevenness, is_whitened, expected
):
    """Residuals are independent of the column; their level differs between the folds.

    Weights with the correlation of the noise leave none that the blocks could miss.
    """
    rng, n_blocks, n_samples = np.random.default_rng(4), 18, 500
    level = 1.0 + unevenness * (np.arange(n_blocks) // 3 % 2)
    column = np.ones((n_blocks, n_samples))
    residual = level[:, None] * rng.standard_normal((n_blocks, n_samples))
    rows = np.stack([column, residual], axis=1)
    blocks = rows @ rows.transpose(0, 2, 1)
    raw_squares, samples = np.array([float(n_blocks * n_samples)]), np.full(n_blocks, float(n_samples))
    tempering, lower_bound = measure_tempering(blocks, raw_squares, 1, samples, is_whitened)
    assert lower_bound == expected and expected <= tempering < expected + 1.0, "seed 4"


def test_the_true_effect_reduces_the_phase_walk_and_the_fit_is_repeated_with_the_smaller_walk(
    tmp_path, monkeypatch
):
    """The phase walk is overestimated a hundredfold as long as the model has no tyre growth."""
    seed = 3
    (hidden,) = write_case(
        tmp_path, seed, ["tyre_growth"], "strong", scope="right", duration=60.0, rate_hz=50.0
    )
    problem = build_problem(read_folder(tmp_path), read_model(tmp_path / "model.toml"))
    state = build_initial_state(problem).with_term(ModelTerm(BY_NAME["tyre_growth"](), "right"))
    tracked, _ = track_wheel_phase(state)
    first_fit, fits = fit_tracked(Evaluation(tracked, estimate_weights(tracked))), []

    def record_fit(evaluation):
        fits.append(evaluation)
        return fit_tracked(evaluation)

    monkeypatch.setattr(refit, "fit_tracked", record_fit)
    final_fit = refit_with_weights(state)
    assert len(fits) == 2, "weights and state agree after the second fit"
    walk_ratios = {}
    for name, fit in (("first", first_fit), ("final", final_fit)):
        _, walks = track_wheel_phase(fit.evaluation.state)
        walk_ratios[name] = fit.evaluation.weights.wheel_walks["right"] / walks["right"]
    assert walk_ratios["first"] > 100.0
    assert 0.9 < walk_ratios["final"] < 1.1
    (growth_estimate,) = (
        term.effect.k for term in final_fit.evaluation.state.terms if term.effect.name == "tyre_growth"
    )
    sigma_ratio = np.sqrt(final_fit.covariance[0, 0] / first_fit.covariance[0, 0])
    assert sigma_ratio < 0.5, "a smaller phase walk reduces the uncertainty"
    assert abs(growth_estimate / hidden.parameters["k"] - 1.0) < 0.05


@pytest.mark.parametrize(("tempering", "is_free"), [(1.5, False), (4.0, True)])
def test_given_effects_are_free_within_their_repeatability_where_residuals_are_correlated(tempering, is_free):
    given = ModelTerm(BY_NAME["lever_arm"](x=0.01), "left", is_fitted=False, repeatability=REPEATABILITY)
    added = ModelTerm(BY_NAME["wheel_camber"](), "left")
    prior = build_prior([added, given], 4, tempering)
    assert prior.is_free.tolist() == [True, *[is_free] * 3]
    assert not prior.value.any()
    if is_free:
        np.testing.assert_allclose(prior.information[1:], tempering / REPEATABILITY**2)


def test_a_hypothesis_holds_the_given_effects_that_its_baseline_holds():
    arm, tilt = (
        ModelTerm(BY_NAME[name](x=0.01), "left", is_fitted=False, repeatability=REPEATABILITY)
        for name in ("lever_arm", "node_misalignment")
    )
    baseline = build_prior([arm, tilt], 6, 4.0).freeze(np.arange(6) < 3)
    terms = [ModelTerm(BY_NAME["wheel_camber"](), "left"), tilt, arm]
    prior = adopt_prior(terms, 7, 30.0, baseline, [arm, tilt])
    assert prior.is_free.tolist() == [True] * 4 + [False] * 3
    own = build_prior(terms, 7, 30.0)
    assert prior.information[0] == own.information[0], "that of a new effect is scaled by its own fit"
    np.testing.assert_allclose(prior.information[1:4], baseline.information[3:])


def test_in_white_noise_a_wrong_value_of_a_given_effect_is_no_nuisance(evaluation):
    """A lever arm that is 0.5 mm wrong, 0.05 usual sizes, stays a visible effect of its own."""
    arm = BY_NAME["lever_arm"](x=5e-4)
    given = ModelTerm(arm, "left", is_fitted=False, repeatability=REPEATABILITY)
    as_given = refit.refit(evaluation.with_state(evaluation.state.with_term(given)), rounds=0)
    fitted = refit.refit(evaluation.with_state(evaluation.state.with_term(ModelTerm(arm, "left"))))
    gain = refit.compute_gain(as_given, fitted)
    print(f"gain of the fitted arm {gain:.0f}, of the given one {as_given.given_gain:.3f}")
    assert gain > 20.0
    assert abs(as_given.given_gain) < 1e-3 * gain
