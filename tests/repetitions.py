"""Further seeds, chips or drives of a test: `make test` runs the first, `make repeat` the others."""

import pytest


def first_and_more(first, *more):
    """Return values for `parametrize`, all but the first with the mark `repeat`.

    A tuple holds one value of each parameter. A single parameter whose value is a tuple is a tuple of it.
    """
    return [_parameters(first), *(_parameters(values, pytest.mark.repeat) for values in more)]


def _parameters(values, *marks):
    return pytest.param(*(values if isinstance(values, tuple) else (values,)), marks=marks)
