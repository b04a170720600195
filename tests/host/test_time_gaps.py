"""Implausibly long gaps in the times of a recording raise an error."""

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.time_gaps import MAX_GAP, check_time_gaps


def test_a_wild_time_stamp_is_reported_with_both_sides_of_the_gap():
    check_time_gaps(np.array([0.0, MAX_GAP]), "log")
    check_time_gaps(np.arange(0.0, 10.0 * MAX_GAP, 0.5 * MAX_GAP), "log")
    with pytest.raises(InputError, match=r"log: nothing between t = 1 s and 1e\+09 s"):
        check_time_gaps(np.array([0.0, 1.0, 1e9]), "log")
    with pytest.raises(InputError, match="nothing between t = 0 s and 3 s"):
        check_time_gaps(np.array([0.0, 3.0]), "log", max_gap=2.0)
