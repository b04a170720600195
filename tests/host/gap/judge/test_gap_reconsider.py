"""Reconsideration of the effects added to the model."""

from types import SimpleNamespace

import pytest

from hubodo.effects import BY_NAME
from hubodo.gap.judge import reconsider
from hubodo.gap.state.terms import ModelTerm


@pytest.mark.parametrize(("accept", "n_judged"), [((), 1), (("gyro_bias",), 2)])
def test_an_effect_that_was_judged_beside_all_others_is_not_judged_again(monkeypatch, accept, n_judged):
    first, last = (ModelTerm(BY_NAME[name](), "left") for name in ("gyro_bias", "lever_arm"))
    rounds = tuple(
        SimpleNamespace(
            best=SimpleNamespace(key=term.key, term=term),
            evaluation=SimpleNamespace(state=SimpleNamespace(terms=terms)),
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
    final = SimpleNamespace(state=SimpleNamespace(terms=(first, last)))
    result = reconsider.SearchResult(rounds, final)
    assert reconsider.reconsider_effects(result, accept) == (result, judged)
    assert calls == [first, last][:n_judged]


def test_a_settled_effect_is_not_judged_again(monkeypatch):
    """Under other weights than those that showed it, a large effect would be taken for noise."""
    terms = tuple(ModelTerm(BY_NAME[name](), "left") for name in ("gyro_bias", "lever_arm"))
    judged = {
        term.key: SimpleNamespace(
            best=SimpleNamespace(key=term.key, term=term), find_hypothesis=lambda key: None
        )
        for term in terms
    }
    calls = []

    def judge_without(self, term, effects):
        calls.append(term)
        return judged[term.key]

    monkeypatch.setattr(reconsider._Reconsideration, "_judge_without", judge_without)
    final = SimpleNamespace(state=SimpleNamespace(terms=terms))
    result = reconsider.SearchResult((), final, used_decimation=True)
    settled = {terms[0].key: judged[terms[0].key]}
    _result, rounds = reconsider.reconsider_effects(result, settled=settled)
    assert calls == [terms[1]] and set(rounds) == set(judged)
