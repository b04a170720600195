"""Further seeds, chips or drives of a test: `make test` runs the first, `make repeat` the others."""

from itertools import product

import pytest


def first_and_more(first, *more):
    """Return values for `parametrize`, all but the first with the mark `repeat`.

    A tuple holds one value of each parameter. A single parameter whose value is a tuple is a tuple of it.
    """
    return [_parameters(first), *(_parameters(values, pytest.mark.repeat) for values in more)]


def each_value_first(*parameters):
    """Return all combinations of the values of parameters, all but a few with the mark `repeat`.

    The few are as many as the longest parameter has values, and contain each value of each parameter.
    """
    n_first = max(map(len, parameters))
    first = [tuple(values[k % len(values)] for values in parameters) for k in range(n_first)]
    return [
        _parameters(values, *(() if values in first else (pytest.mark.repeat,)))
        for values in product(*parameters)
    ]


def _parameters(values, *marks):
    return pytest.param(*(values if isinstance(values, tuple) else (values,)), marks=marks)
