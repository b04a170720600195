"""When a look at the chip shows what it shows, on processors that are slow in their own way."""

import pytest
from poll_timing import PollTiming

WIRE_US = 300
ANSWERS_US = 72
"""Two addresses and a register of nine bits each, start and restart, at 400 kHz."""
WRAPS_US = 1 << 30


def test_the_first_look_is_as_early_as_the_wire_alone_makes_it():
    assert PollTiming(0, WIRE_US).due_us(10_000) == 10_000 - ANSWERS_US


@pytest.mark.parametrize("way_us", [0, 30, 700])
@pytest.mark.parametrize("call_us", [0, 45])
@pytest.mark.parametrize("begin_us", [0, WRAPS_US - 2000])
def test_a_processor_that_is_always_as_slow_learns_when_to_set_out(way_us, call_us, begin_us):
    """To a fourth of what is left of the way each time, in whole microseconds."""
    timing = PollTiming(begin_us % WRAPS_US, WIRE_US)
    for turn in range(40):
        wanted = begin_us + 1000 * (turn + 1)
        begun = timing.due_us(wanted % WRAPS_US) + way_us
        timing.record((begun - way_us) % WRAPS_US, begun % WRAPS_US, (begun + call_us + WIRE_US) % WRAPS_US)
        shown = (begun + call_us + ANSWERS_US) % WRAPS_US
        assert timing.early_us == timing.late_us == shown
    assert abs(shown - wanted % WRAPS_US) <= 3


def test_what_a_look_took_longer_than_the_quickest_is_doubt():
    timing = PollTiming(0, WIRE_US)
    timing.record(0, 10, 10 + WIRE_US + 20)
    timing.record(1000, 1010, 1010 + WIRE_US + 75)
    assert (timing.slack_us, timing.late_us - timing.early_us) == (55, 55)
    assert timing.early_us == 1010 + 20 + ANSWERS_US


def test_one_way_that_took_a_millisecond_is_not_the_ordinary_one():
    timing = PollTiming(0, WIRE_US)
    timing.record(0, 1000, 1000 + WIRE_US)
    assert timing.due_us(10_000) == 10_000 - ANSWERS_US
