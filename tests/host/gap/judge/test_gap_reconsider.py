"""Reconsideration of the effects added to the model."""

from types import SimpleNamespace

import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.judge import reconsider
from hubodo.gap.judge.hypothesis import Hypothesis
from hubodo.gap.refit.cross_validation import HeldOutGain
from hubodo.gap.state.terms import ModelTerm


@pytest.mark.parametrize(("accept", "n_judged"), [((), 1), (("gyro_bias",), 2)])
def test_an_effect_that_was_judged_beside_all_others_is_not_judged_again(monkeypatch, accept, n_judged):
    first, last = (ModelTerm(BY_NAME[name](), "left") for name in ("gyro_bias", "lever_arm"))
    rounds = tuple(
        SimpleNamespace(
            best=SimpleNamespace(key=term.key, term=term),
            evaluation=SimpleNamespace(state=SimpleNamespace(terms=terms, has_correlated_noise=False)),
            find_hypothesis=lambda key: None,
        )
        for term, terms in ((first, ()), (last, (first,)))
    )
    judged = {first.key: rounds[0], last.key: rounds[1]}
    calls = []

    def judge_without(self, term, effects):
        calls.append(term)
        return judged[term.key]

    monkeypatch.setattr(reconsider._Reconsideration, "_judge_without", judge_without)
    final = SimpleNamespace(state=SimpleNamespace(terms=(first, last), has_correlated_noise=False))
    result = reconsider.SearchResult(rounds, final)
    assert reconsider.reconsider_effects(result, accept) == (result, judged)
    assert calls == [first, last][:n_judged]


@pytest.mark.parametrize(
    ("tempering", "last_tempering", "held_out", "is_dropped"),
    [
        (1.0, 13.5, 33.0, True),
        (1.0, 13.5, 1400.0, False),
        (1.0, 1.5, 33.0, False),
        (5.0, 13.5, 33.0, False),
        # Confirmed, but by no more than an uneven level of the noise gains.
        (1.0, 40.0, 900.0, True),
    ],
)
def test_a_drift_that_no_held_out_sample_confirms_is_dropped_where_residuals_are_correlated(
    monkeypatch, tempering, last_tempering, held_out, is_dropped
):
    """A random walk of a gyro between standstills, through which a warm-up passes."""
    monkeypatch.setattr(reconsider, "refit_with_weights", lambda state: state)
    monkeypatch.setattr(Hypothesis, "p_value", lambda self, distribution: 0.0)
    term = ModelTerm(BY_NAME["gyro_warmup"](), "right")
    gain = HeldOutGain(held_out, 333.0, 1832.7)
    warmup = Hypothesis(term, 1469.6, 1450.6, 1.0, "fitted", held_out_gain=gain)
    judged = SimpleNamespace(tempering=tempering, find_hypothesis=lambda key: warmup)
    last = SimpleNamespace(tempering=last_tempering, null_distribution=None)
    state = SimpleNamespace(terms=[term], without_terms=lambda keys: list(keys))
    result = reconsider.SearchResult((judged, last), SimpleNamespace(state=state))
    reduced, _rounds = reconsider.drop_chance_effects(result, {term.key: judged})
    assert (reduced.final == [term.key]) == is_dropped
