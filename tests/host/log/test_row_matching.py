"""Rows of a table joined from several channels."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hubodo.log.row_matching import first_row_at_each_time, match_sequences, rows_of_sequences

SEQUENCES = st.lists(st.integers(0, 30), min_size=1, unique=True)


@given(st.lists(SEQUENCES, min_size=1, max_size=4))
def test_rows_of_all_channels_are_joined_and_the_others_counted(channels):
    common, n_incomplete = match_sequences([np.array(numbers) for numbers in channels])
    expected = set.intersection(*map(set, channels))
    assert common.tolist() == sorted(expected) or common.tolist() == channels[0]
    assert set(common.tolist()) == expected
    assert n_incomplete == max(len(expected | set(numbers)) - len(expected) for numbers in channels)
    for numbers in channels:
        assert np.array_equal(np.array(numbers)[rows_of_sequences(np.array(numbers), common)], common)


def test_of_rows_with_the_same_time_the_first_is_used_in_order_of_time():
    t = np.array([3.0, 1.0, 3.0, 2.0, 1.0])
    assert first_row_at_each_time(t).tolist() == [1, 3, 0]
    assert first_row_at_each_time(np.arange(3.0)) == slice(None)
