"""Conversion between seconds and nanoseconds."""

from decimal import Decimal

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from hubodo.log.timebase import (
    MAX_EXACT_S,
    format_decimal_seconds,
    parse_decimal_seconds,
    round_trips_exactly,
    to_ns,
    to_seconds,
)

NS = st.integers(-(2**62), 2**62)


@given(NS)
def test_decimal_seconds_are_exact_in_both_directions(t_ns):
    text = format_decimal_seconds(t_ns)
    assert Decimal(text) == Decimal(t_ns) / 10**9
    assert parse_decimal_seconds([text.encode()]).tolist() == [t_ns]


@given(st.integers(0, int(MAX_EXACT_S * 1e9)), st.integers(0, 2**60))
@example(8_388_607_999_999_999, 0)
def test_nanoseconds_below_the_limit_are_converted_exactly(t_ns, t_zero_ns):
    t = to_seconds(np.array([t_zero_ns + t_ns]), t_zero_ns)
    assert to_ns(t, t_zero_ns).tolist() == [t_zero_ns + t_ns]
    assert round_trips_exactly(t, t_zero_ns)


def test_times_between_nanoseconds_do_not_round_trip_and_other_text_is_refused():
    assert not round_trips_exactly(np.array([0.5e-9]), 0)
    assert parse_decimal_seconds([b"1.5", b"1e3"]) is None


def test_beyond_the_limit_float64_merges_neighbouring_nanoseconds():
    t = to_seconds(np.array([9_007_199_254_740_981, 9_007_199_254_740_982]), 0)
    assert t[0] > MAX_EXACT_S and t[0] == t[1]
