"""Figures of the fleet page."""

import numpy as np

from hubodo.fleet.figures import _trim_extremes


def test_the_histogram_spans_the_bulk_and_not_single_extremes():
    values = np.append(np.linspace(0.0, 1.0, 1000), [50.0, -50.0])
    trimmed = _trim_extremes(values)
    assert len(trimmed) == 1000 and (trimmed.min(), trimmed.max()) == (0.0, 1.0)
