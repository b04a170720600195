"""Stamps of publishers with right, offset, drifting, stepping and missing clocks."""

import numpy as np
import pytest

from hubodo.ingest.topic.stamp_clock import StampClock

START_NS = 1_790_000_000_000_000_000
PERIOD_NS = 5_000_000
WALL_OFFSET_NS = 40_000_000_000  # the host clock is ahead of the wall clock


def feed(clock, stamps, delays):
    """Return the host times of stamps of the wall clock plus offsets; delays: ns from stamp to arrival."""
    host = []
    for n, (offset_ns, delay_ns) in enumerate(zip(stamps, delays, strict=True)):
        true_ns = START_NS + n * PERIOD_NS
        host.append(
            clock.to_host_ns(
                true_ns + int(offset_ns), true_ns + WALL_OFFSET_NS + int(delay_ns), WALL_OFFSET_NS
            )
        )
    return host


def delays(count, seed=1):
    return np.random.default_rng(seed).exponential(2e6, count)


def test_stamps_of_this_computer_are_converted_exactly_whatever_the_delay():
    host = feed(StampClock(), np.zeros(400), delays(400) + np.repeat([0, 3e9, 0, 0], 100))
    assert host == [START_NS + WALL_OFFSET_NS + n * PERIOD_NS for n in range(400)]


def test_another_clock_is_estimated_from_arrivals_within_the_jitter():
    # An hour off and 50 ppm fast.
    count, drift = 4000, 50e-6
    host = feed(StampClock(), 3.6e12 + drift * PERIOD_NS * np.arange(count), delays(count))
    error = np.array(host) - (START_NS + WALL_OFFSET_NS + PERIOD_NS * np.arange(count))
    assert np.all(np.diff(host) > 0)
    assert np.abs(error[1000:]).max() < 3e6


def test_single_wrong_stamps_are_refused_and_change_nothing():
    offsets = np.zeros(300)
    offsets[[50, 120, 121, 200]] = [-3.6e12, 1e9, 2e18, -60e9]
    host = feed(StampClock(), offsets, delays(300))
    assert [n for n, t in enumerate(host) if t is None] == [50, 120, 121, 200]
    assert host[201] == START_NS + WALL_OFFSET_NS + 201 * PERIOD_NS


def test_a_wrong_first_stamp_is_forgotten_once_the_others_agree():
    offsets = np.zeros(100)
    offsets[0] = -3.6e12
    host = feed(StampClock(), offsets, delays(100))
    assert host[50] == START_NS + WALL_OFFSET_NS + 50 * PERIOD_NS


@pytest.mark.parametrize("step_s", [-100.0, 5.0, 3600.0])
def test_a_publisher_whose_clock_is_set_is_followed(step_s):
    clock = StampClock()
    offsets = np.repeat([0.0, step_s * 1e9], [200, 400])
    host = feed(clock, offsets, delays(600))
    assert clock.steps == 1
    assert host[200] is None
    error = np.array(host[230:]) - (START_NS + WALL_OFFSET_NS + PERIOD_NS * np.arange(230, 600))
    assert np.abs(error).max() < 25e6


def test_a_stamp_that_was_not_set_is_the_time_of_arrival():
    assert StampClock().to_host_ns(0, 77, 5) == 77
