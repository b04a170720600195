"""Times of a stream keep the node's own intervals while its clock estimate improves."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.ingest.node.slewed_times import SlewedTimes
from hubodo.units import NS_PER_S

PERIOD_NS = 2_403_846
T0 = 1_700_000_000 * NS_PER_S


@dataclass
class SettableClock:
    """A clock whose estimate is set by the test."""

    offset: int = T0
    revision: int = 0
    restarts: int = 0

    def to_host_ns(self, device_ns):
        return device_ns + self.offset

    def correct(self, by, *, restart=False):
        self.offset += by
        self.revision += 1
        self.restarts += restart


def samples(first, count):
    return np.arange(first, first + count, dtype=np.int64) * PERIOD_NS


def test_a_correction_is_slewed_at_100_ppm_until_it_is_complete():
    for by in (-900_000, 900_000):
        clock = SettableClock()
        times = SlewedTimes(clock)
        before = times.to_host_ns(samples(0, 10))
        clock.correct(by)
        after = times.to_host_ns(samples(10, 5000))
        np.testing.assert_array_equal(before, samples(0, 10) + T0)
        intervals = np.diff(np.concatenate([before, after])) / PERIOD_NS
        assert 0.9e-4 < np.abs(intervals - 1).max() <= 1.01e-4
        # 0.9 ms at 100 ppm: nine seconds.
        is_done = after - samples(10, 5000) - T0 == by
        assert (
            abs(np.argmax(is_done) * PERIOD_NS / NS_PER_S - 9.0) < 0.01
            and is_done[np.argmax(is_done) :].all()
        )


def test_a_large_correction_is_applied_at_once():
    clock = SettableClock()
    times = SlewedTimes(clock)
    times.to_host_ns(samples(0, 10))
    clock.correct(5_000_000)
    np.testing.assert_array_equal(times.to_host_ns(samples(10, 10)), samples(10, 10) + T0 + 5_000_000)


def test_a_correction_that_would_repeat_published_times_is_slewed_at_a_thousandth_until_it_is_complete():
    clock = SettableClock()
    times = SlewedTimes(clock)
    last = times.to_host_ns(samples(0, 10))[-1]
    clock.correct(-3 * NS_PER_S)
    number, after = 10, []
    while not after or after[-1] > number * PERIOD_NS + T0 - 3 * NS_PER_S:
        after += times.to_host_ns(samples(number, 1000)).tolist()
        number += 1000
        clock.correct(100 if number % 2000 else -100)  # further exchanges change the estimate a little
    intervals = np.diff([last, *after]) / PERIOD_NS
    assert 0.9e-3 < 1.0 - intervals.min() <= 1.01e-3
    assert intervals.max() < 1.0 + 1e-4
    assert number * PERIOD_NS / NS_PER_S == pytest.approx(3000.0, rel=0.01)


def test_a_clock_that_stood_still_is_followed_at_once_beyond_a_gap():
    """The computer was suspended for an hour and did not count it; the node did."""
    clock = SettableClock()
    times = SlewedTimes(clock)
    times.to_host_ns(samples(0, 10))
    hour = 3600 * NS_PER_S
    clock.correct(-hour)
    np.testing.assert_array_equal(times.to_host_ns(samples(10, 9) + hour), samples(10, 9) + T0)


def test_a_restart_takes_nothing_over():
    clock = SettableClock()
    times = SlewedTimes(clock)
    last = times.to_host_ns(samples(0, 1000))[-1]
    # Starts from 0, 1 ms after the time by the previous clock.
    clock.correct(1000 * PERIOD_NS + 1_000_000, restart=True)
    again = times.to_host_ns(samples(0, 10))
    np.testing.assert_array_equal(again, last + PERIOD_NS + 1_000_000 + samples(0, 10))


@given(
    st.lists(st.tuples(st.integers(1, 30), st.integers(-8_000_000, 8_000_000)), max_size=12),
    st.integers(1, 7),
)
def test_the_block_size_does_not_matter_and_no_time_is_repeated(parts, size):
    whole_clock, part_clock = SettableClock(), SettableClock()
    whole, part, number, times = SlewedTimes(whole_clock), SlewedTimes(part_clock), 0, []
    for count, by in parts:
        expected = whole.to_host_ns(samples(number, count)).tolist()
        block_times = []
        for first in range(number, number + count, size):
            block_times += part.to_host_ns(samples(first, min(size, number + count - first))).tolist()
        assert block_times == expected
        times += block_times
        number += count
        whole_clock.correct(by)
        part_clock.correct(by)
    assert times == sorted(set(times))
