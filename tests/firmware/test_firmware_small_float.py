"""Small floats: every operation is accurate to 2^-18 and uses 31 bits."""

import math

import native
import small_float
from hypothesis import given, settings
from hypothesis import strategies as st
from small_int import SmallInt

ULP = 2.0**-18


def value(x):
    return (x >> 8) * 2.0 ** ((x & 255) - 128) if x else 0.0


NUMBERS = st.builds(
    lambda m, e: SmallInt(small_float.number(SmallInt(m), SmallInt(e))),
    st.integers(-(1 << 30) + 1, (1 << 30) - 1),
    st.integers(-50, 20),
)
NOT_ZERO = NUMBERS.filter(bool)


@settings(max_examples=300)
@given(st.integers(-(1 << 30) + 1, (1 << 30) - 1), st.integers(-80, 80))
def test_an_integer_can_be_converted_and_back(m, e):
    x = small_float.number(SmallInt(m), SmallInt(e))
    assert math.isclose(value(x), m * 2.0**e, rel_tol=ULP)
    back = small_float.integer(x, -e)
    assert abs(back - max(-(1 << 29), min(m, 1 << 29))) <= abs(m) * ULP + 0.5


@settings(max_examples=300)
@given(NOT_ZERO, NOT_ZERO)
def test_products_quotients_and_roots_are_accurate_to_2_to_the_minus_18(x, y):
    assert math.isclose(value(small_float.times(x, y)), value(x) * value(y), rel_tol=ULP)
    assert math.isclose(value(small_float.over(x, y)), value(x) / value(y), rel_tol=ULP)
    size = x if value(x) > 0 else small_float.minus(x)
    assert math.isclose(value(small_float.root(SmallInt(size))), math.sqrt(value(size)), rel_tol=ULP)


@settings(max_examples=300)
@given(NUMBERS, NUMBERS)
def test_sums_are_accurate_relative_to_the_larger_operand(x, y):
    result = value(small_float.plus(x, y))
    assert abs(result - (value(x) + value(y))) <= 2 * ULP * max(abs(value(x)), abs(value(y)))
    assert value(small_float.minus(x)) == -value(x)
    assert small_float.plus(x, small_float.minus(x)) == 0


def test_underflow_gives_zero_and_overflow_saturates():
    tiny, huge = small_float.number(1, -100), small_float.number(1, 120)
    assert value(small_float.ONE) == 1.0
    assert small_float.times(tiny, tiny) == 0
    largest = value(small_float.times(huge, huge))
    assert largest > 2.0**140
    assert value(small_float.times(huge, small_float.minus(huge))) == -largest
    assert value(small_float.over(huge, tiny)) == largest
    assert small_float.integer(small_float.minus(huge), 0) == -small_float.INTEGER_LIMIT


@settings(max_examples=300)
@given(NUMBERS, NUMBERS, st.integers(-(1 << 30) + 1, (1 << 30) - 1), st.integers(-160, 160))
def test_the_native_functions_give_the_same_bits(x, y, m, e):
    fast = native.load("fast_float")
    x, y = int(x), int(y)
    assert fast.number(m, e) == small_float.number_plain(m, e)
    assert fast.integer(x, e % 80 - 40) == small_float.integer_plain(x, e % 80 - 40)
    assert fast.times(x, y) == small_float.times_plain(x, y)
    assert fast.plus(x, y) == small_float.plus_plain(x, y)
    if y:
        assert fast.over(x, y) == small_float.over_plain(x, y)
    far = small_float.number_plain(m, 100)
    assert fast.times(far, far) == small_float.times_plain(far, far)
