"""Reconsideration of the effects that were added."""

from types import SimpleNamespace

from hubodo.gap.judge.reconsider import reconsider_effects


def test_a_single_effect_that_was_judged_beside_all_others_is_not_judged_again():
    term = SimpleNamespace(key=("gyro_bias", "left"), is_fitted=True)
    judged = SimpleNamespace(best=SimpleNamespace(key=term.key))
    final = SimpleNamespace(state=SimpleNamespace(terms=(term,)))
    result = SimpleNamespace(final=final, rounds=(judged,), used_decimation=False)
    assert reconsider_effects(result) == (result, {term.key: judged})
