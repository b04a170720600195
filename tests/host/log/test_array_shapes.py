"""Tables of numbers in arrays of any orientation."""

import numpy as np
import pytest

from hubodo.log.array_shapes import is_number_table, placeholder_rows, samples_as_rows


@pytest.mark.parametrize("shape", [(1000, 3), (3, 1000), (1000,), (1, 1000), (40, 50), (2, 2)])
def test_samples_become_rows_and_a_placeholder_has_the_same_shape(shape):
    values = np.arange(float(np.prod(shape))).reshape(shape)
    rows = samples_as_rows(values)
    assert placeholder_rows(shape).shape == rows.shape and rows.size == values.size
    assert rows.shape == {(3, 1000): (1000, 3), (1, 1000): (1000, 1), (1000,): (1000, 1)}.get(shape, shape)


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [("bool", (9,)), ("U3", (9,)), ("f8", ()), ("f8", (1, 1)), ("f8", (2, 2, 2)), ("c16", (9,))],
)
def test_anything_but_several_real_numbers_in_one_or_two_dimensions_is_no_table(dtype, shape):
    assert not is_number_table(np.dtype(dtype), shape)
    assert is_number_table(np.dtype("i2"), (9, 3))
