"""The class that a scaffold writes says whether it can be worked out some samples at a time."""

import pytest

from hubodo.gap.scaffold.library import CHANNELS, shapes
from hubodo.gap.scaffold.source import Summand, as_class, source

WEIGHTS = [shape.weight for shape in shapes()]


@pytest.mark.parametrize("weight", sorted(set(WEIGHTS)))
def test_a_formula_that_looks_beyond_its_own_sample_says_that_it_remembers(weight):
    shape = next(shape for shape in shapes() if shape.weight == weight)
    made = [Summand(shape, (CHANNELS[2],))]
    assert as_class("odd_one", made).has_memory == ("temperature_rate" in weight)
    assert ("has_memory: ClassVar[bool] = True" in source("odd_one", made)) == ("temperature_rate" in weight)
