"""Score test for a change between two logs."""

from hubodo.gap.change.score_test import compare_logs


def test_a_log_does_not_differ_from_itself(evaluation):
    comparison = compare_logs(evaluation, evaluation)
    assert comparison.p_value > 0.5
    assert max(it.gain for it in comparison.differences) < 1e-6
