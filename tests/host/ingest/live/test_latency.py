"""The latency histogram."""

import numpy as np
import pytest

from hubodo.ingest.live.latency import LatencyHistogram


def test_quantiles_are_exact_to_a_bin_and_never_below_the_true_value():
    seed = 7
    durations = np.random.default_rng(seed).integers(0, 90_000_000, 5000)
    histogram = LatencyHistogram()
    for ns in durations.tolist():
        histogram.add(ns)
    for share in (0.1, 0.5, 0.99):
        true = np.sort(durations)[int(np.ceil(share * len(durations))) - 1] * 1e-9
        assert 0.0 <= histogram.quantile(share) - true <= 20.001e-6, f"seed {seed}"
    assert histogram.maximum == pytest.approx(durations.max() * 1e-9)
    assert histogram.mean == pytest.approx(durations.mean() * 1e-9)


def test_an_empty_histogram_has_no_values_and_a_long_duration_is_exact():
    histogram = LatencyHistogram()
    assert set(histogram.as_json().values()) == {None}
    histogram.add(3_000_000_001)
    assert histogram.quantile(0.5) == histogram.maximum == pytest.approx(3.000000001)
