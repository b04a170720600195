"""Causes that no drive can distinguish."""

from hubodo.gap.explain.indistinguishable import INDISTINGUISHABLE_CAUSES


def test_each_pair_of_causes_is_listed_once_with_a_reason():
    pairs = [frozenset(causes) for *causes, _ in INDISTINGUISHABLE_CAUSES]
    assert len(set(pairs)) == len(pairs) and all(len(pair) == 2 for pair in pairs)
    assert all(reason for *_, reason in INDISTINGUISHABLE_CAUSES)
