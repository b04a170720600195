"""The source of a scaffolded effect class, and its has_memory flag."""

import pytest

from hubodo.gap.scaffold.library import CHANNELS, list_shapes
from hubodo.gap.scaffold.source import Summand, compile_effect, render_source

WEIGHTS = [shape.weight for shape in list_shapes()]


@pytest.mark.parametrize("weight", sorted(set(WEIGHTS)))
def test_has_memory_is_set_if_the_formula_uses_other_samples(weight):
    shape = next(shape for shape in list_shapes() if shape.weight == weight)
    has_memory = "temperature_rate" in weight
    summands = [Summand(shape, (CHANNELS[2],))]
    assert compile_effect("odd_one", summands).has_memory == has_memory
    assert ("has_memory: ClassVar[bool] = True" in render_source("odd_one", summands)) == has_memory
