"""Record length needed for a noise term: monotonic in its size, and exact for the rate ramp."""

import numpy as np
import pytest

from hubodo.sensors.allan.deviation import AllanPoints
from hubodo.sensors.allan.likelihood import K, R, slope_sigma
from hubodo.sensors.allan.record_length import required_record_length

WHITE = np.array([0.0, 1e-6, 0.0, 0.0, 0.0])
EMPTY = np.zeros(0)
POINTS = AllanPoints(EMPTY.astype(np.int64), EMPTY, EMPTY, EMPTY.astype(np.int64), 1 << 12, 0.1)


def test_a_smaller_random_walk_needs_a_longer_record():
    lengths = [required_record_length(K, size, WHITE, POINTS, 6) for size in (3e-4, 1e-4, 3e-5)]
    assert lengths == sorted(lengths) and lengths[0] < lengths[-1]


def test_a_ramp_needs_the_length_at_which_it_is_three_sigma_of_the_slope():
    size = 1e-7
    length = required_record_length(R, size, WHITE, POINTS, 6)
    assert 3.0 * slope_sigma(WHITE, length) < size <= 3.0 * slope_sigma(WHITE, length / 2.0)


@pytest.mark.parametrize("term", [K, R])
def test_a_vanishing_term_is_out_of_reach(term):
    assert required_record_length(term, 1e-15, WHITE, POINTS, 6) is None
