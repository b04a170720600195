"""Position of a node's decoder in its streams: device time of a batch, samples lost between two."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.node_messages import hello
from hubodo.ingest.node.boot import BatchTail, BootState, count_lost_samples, unwrap_first_sample
from hubodo.ingest.node.wire_batch import WireBatch

PERIOD_NS = 2_403_846
TURN_US = 1 << 30


def _batch(t_us: int, count: int = 16) -> WireBatch:
    return WireBatch(t_us % TURN_US, PERIOD_NS, 0, 0, 0, count, np.zeros((count, 6), np.int16))


@given(st.integers(0, 65535), st.integers(0, 5 * 65536), st.floats(-300.0, 300.0))
def test_the_number_of_lost_samples_is_exact_far_beyond_the_range_of_their_numbers(
    next_index: int, lost: int, drift_ppm: float
) -> None:
    """Sample numbers have 16 bits; the device time gives the number of their turns."""
    tail = BatchTail(next_index, 1_000_000_000, PERIOD_NS, 0)
    first_ns = 1_000_000_000 + round(lost * PERIOD_NS * (1.0 + drift_ppm * 1e-6))
    assert count_lost_samples(tail, (next_index + lost) & 0xFFFF, first_ns, PERIOD_NS, False) == lost


def test_after_an_overrun_sample_numbers_that_contradict_the_time_are_not_used() -> None:
    """They may differ by 16 samples and 5 % of the silence."""
    start_ns = 40_000_000_000

    def lost(by_index: int, by_time: int) -> int | None:
        tail = BatchTail(5000, start_ns, PERIOD_NS, 0)
        index = (5000 + by_index) & 0xFFFF
        return count_lost_samples(tail, index, start_ns + by_time * PERIOD_NS, PERIOD_NS, True)

    assert lost(-5000, 300) is None
    assert lost(300, 300) == 300
    assert (lost(300, 331), lost(300, 334)) == (300, None)
    assert (lost(10_000, 10_500), lost(10_000, 10_600)) == (10_000, None)


def test_a_batch_that_overlaps_the_one_before_loses_no_negative_number_of_samples() -> None:
    assert count_lost_samples(BatchTail(100, 0, PERIOD_NS, 0), 90, -10 * PERIOD_NS, PERIOD_NS, False) == 0


def test_the_time_in_which_a_node_was_asleep_is_none_of_lost_samples() -> None:
    tail, ten_hours_ns = BatchTail(100, 0, PERIOD_NS, 0), 36_000 * 10**9
    assert count_lost_samples(tail, 100, ten_hours_ns, PERIOD_NS, False, rate_changed=True) == 0
    assert count_lost_samples(tail, 116, ten_hours_ns, PERIOD_NS, False, rate_changed=True) == 16


def test_the_first_batch_of_a_boot_has_the_device_time_that_it_states() -> None:
    assert unwrap_first_sample(BootState(hello()), _batch(123_456), 0, 0) == 123_456_000


@pytest.mark.parametrize("turns", [1, 3])
def test_ticks_that_turned_over_while_the_host_slept_are_counted_by_the_lost_frames(turns: int) -> None:
    """The host clock stood still, so only the node's counters show how long the silence was."""
    boot = BootState(hello())
    start_us = 500_000_000
    first_ns = unwrap_first_sample(boot, _batch(start_us), 0, 0)
    boot.tail = BatchTail(16, first_ns + 16 * PERIOD_NS, PERIOD_NS, 0)
    silence_us = turns * TURN_US + 7_000_000
    lost = (silence_us * 1000 - 16 * PERIOD_NS) // (16 * PERIOD_NS)
    found_ns = unwrap_first_sample(boot, _batch(start_us + silence_us), 1_000_000_000, lost)
    assert found_ns == (start_us + silence_us) * 1000
