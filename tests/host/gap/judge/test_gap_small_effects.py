"""Small effects: named under weights with the correlation of the noise, and only if they explain the log."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from coloured_noise import with_coloured_noise
from hubodo.effects import effect_of
from hubodo.gap.judge import small_effects
from hubodo.gap.judge.round import judge_round
from hubodo.gap.judge.search import build_initial_state, search_effects
from hubodo.gap.judge.small_effects import search_small_effects
from hubodo.gap.refit.refit import refit_with_weights
from hubodo.gap.state.terms import ModelTerm

SEED = 5
# Bias of the accelerometers along and across a spoke, in sigma of the noise.
SMALL_BIAS = np.array([0.0, 0.0, 0.0, 0.018, 0.012, 0.0])[:, None]


def search(evaluation, added):
    """Return the result with white weights, and the one with small effects."""
    state = with_coloured_noise(
        evaluation, np.random.default_rng(SEED), slow_ratio=0.0, added={"left": added}
    )
    white = search_effects(build_initial_state(state.problem))
    return white, search_small_effects(white)


def list_names(result):
    return [term.key for term in result.final.state.terms if term.is_fitted]


def test_a_search_in_white_noise_is_complete(evaluation):
    white = search_effects(evaluation.state)
    assert search_small_effects(white) is white


def test_a_small_bias_is_named_in_coloured_noise(long_evaluation):
    white, small = search(long_evaluation, SMALL_BIAS)
    best = small.rounds[-2].best
    print(list_names(white), list_names(small), best and (best.gain, best.surprise))
    assert not list_names(white)
    assert list_names(small) == [("accel_bias", "left")]


def test_coloured_noise_alone_is_no_small_effect(long_evaluation):
    white, small = search(long_evaluation, 0.0)
    assert not list_names(white) and not list_names(small)


def test_structure_that_no_effect_explains_is_not_named(long_evaluation):
    """Waves of the wheel angle in all axes resemble several effects, and no few of them explain the log."""
    rolling = long_evaluation.state.predictions["left"].rolling
    spin = np.abs(rolling.spin) / np.abs(rolling.spin).max()
    waves = [
        spin**k * np.cos(m * rolling.angle + k) for k, m in ((3, 1), (2, 1), (3, 2), (1, 1), (2, 2), (3, 3))
    ]
    white, small = search(long_evaluation, 0.25 * np.stack(waves))
    correlated = refit_with_weights(replace(white.final.state, has_correlated_noise=True))
    best = judge_round(correlated.evaluation).best
    print(list_names(white), best and (best.key, best.gain))
    assert best is not None
    assert small is white


@pytest.mark.parametrize("names", [["empirical:gx ~ spin^2"], ["gyro_bias", "accel_bias", "lever_arm"] * 2])
def test_a_model_with_structure_or_many_effects_is_not_searched_for_small_ones(names):
    terms = tuple(ModelTerm(effect_of(name)(), "left", is_fitted=True) for name in names)
    result = SimpleNamespace(final=SimpleNamespace(state=SimpleNamespace(terms=terms)))
    assert search_small_effects(result) is result


@pytest.mark.parametrize(("gap", "is_used"), [(1.605, True), (1.64, False)])
def test_a_fit_with_correlation_that_explains_less_than_the_white_one_is_not_used(monkeypatch, gap, is_used):
    """The gap fell from 1.65 to 1.60: weights estimated beside a warm-up took its slow end for noise."""
    gaps = {"start": 1.65, "white": 1.60, "correlated": gap}
    monkeypatch.setattr(small_effects, "compute_gap", gaps.__getitem__)

    def evaluation(name):
        return SimpleNamespace(without_cache=lambda: SimpleNamespace(residuals=name))

    result = SimpleNamespace(
        rounds=(SimpleNamespace(evaluation=evaluation("start")),),
        final=SimpleNamespace(evaluation=evaluation("white")),
    )
    fit = SimpleNamespace(evaluation=evaluation("correlated"))
    assert small_effects._explains_less(result, fit) != is_used
