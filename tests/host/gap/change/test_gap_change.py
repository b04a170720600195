"""The result of comparing two logs."""

import pytest

from hubodo.gap.change.result import CHANGE_P_VALUE, ChangeResult


@pytest.mark.parametrize(("p_value", "has_changed"), [(0.1 * CHANGE_P_VALUE, True), (0.5, False)])
def test_a_p_value_below_the_threshold_means_that_the_logs_differ(p_value, has_changed):
    result = ChangeResult(p_value, (), (), None, None, ("a warning",))
    assert result.has_changed is has_changed
    assert result.as_json() == {
        "changed": has_changed,
        "p_value": p_value,
        "changes": [],
        "unnamed": [],
        "correlated": False,
        "warnings": ["a warning"],
    }
