"""The class that a scaffold writes says whether it can be worked out some samples at a time."""

import pytest

from hubodo.gap.scaffold.library import CHANNELS, list_shapes
from hubodo.gap.scaffold.source import Summand, compile_effect, render_source

WEIGHTS = [shape.weight for shape in list_shapes()]


@pytest.mark.parametrize("weight", sorted(set(WEIGHTS)))
def test_a_formula_that_looks_beyond_its_own_sample_says_that_it_remembers(weight):
    shape = next(shape for shape in list_shapes() if shape.weight == weight)
    made = [Summand(shape, (CHANNELS[2],))]
    assert compile_effect("odd_one", made).has_memory == ("temperature_rate" in weight)
    assert ("has_memory: ClassVar[bool] = True" in render_source("odd_one", made)) == (
        "temperature_rate" in weight
    )
