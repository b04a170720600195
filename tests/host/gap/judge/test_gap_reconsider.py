"""Reconsideration of the effects added to the model."""

from types import SimpleNamespace

from hubodo.gap.judge.reconsider import reconsider_effects


def test_a_single_effect_already_compared_with_all_others_is_not_reconsidered():
    term = SimpleNamespace(key=("gyro_bias", "left"), is_fitted=True)
    last_round = SimpleNamespace(best=SimpleNamespace(key=term.key))
    evaluation = SimpleNamespace(state=SimpleNamespace(terms=(term,)))
    result = SimpleNamespace(final=evaluation, rounds=(last_round,), used_decimation=False)
    assert reconsider_effects(result) == (result, {term.key: last_round})
