"""Log times over all nodes, and the sample rate."""

import numpy as np
import pytest

from hubodo.ingest.node.log_times import LogTimeSequence, RateWindow
from hubodo.units import NS_PER_S


def test_log_times_increase_strictly_one_by_one_and_many_at_once():
    received = np.array([5, 5, 3, 9, 9, 9, 20], np.int64)
    single, many = LogTimeSequence(), LogTimeSequence()
    times = [single.next_time(int(t)) for t in received]
    assert times == [5, 6, 7, 9, 10, 11, 20]
    assert many.next_times(received[:3]).tolist() + many.next_times(received[3:]).tolist() == times


def test_the_rate_is_that_of_the_last_two_seconds():
    window = RateWindow()
    for k in range(50):
        window.add(k * NS_PER_S // 10, 20)
    assert window.rate(5 * NS_PER_S) == pytest.approx(200.0)
    assert window.rate(60 * NS_PER_S) == 0.0
