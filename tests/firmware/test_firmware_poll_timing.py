"""Time bounds of each poll of a chip, on processors with different delays."""

import pytest
from poll_timing import PollTiming

WIRE_US = 300
ADDRESS_US = 72
"""Two addresses and a register of nine bits each, with start and restart, at 400 kHz."""
WRAP_US = 1 << 30


def test_the_first_poll_is_early_by_the_time_on_the_wire():
    assert PollTiming(0, WIRE_US).due_us(10_000) == 10_000 - ADDRESS_US


@pytest.mark.parametrize("delay_us", [0, 30, 700])
@pytest.mark.parametrize("call_us", [0, 45])
@pytest.mark.parametrize("start_us", [0, WRAP_US - 2000])
def test_polls_converge_to_the_requested_time_with_a_constant_delay(delay_us, call_us, start_us):
    """Each poll reduces the remaining error to a fourth, in whole microseconds."""
    timing = PollTiming(start_us % WRAP_US, WIRE_US)
    for k in range(40):
        requested = start_us + 1000 * (k + 1)
        bus_start = timing.due_us(requested % WRAP_US) + delay_us
        timing.record(
            (bus_start - delay_us) % WRAP_US, bus_start % WRAP_US, (bus_start + call_us + WIRE_US) % WRAP_US
        )
        sampled = (bus_start + call_us + ADDRESS_US) % WRAP_US
        assert timing.early_us == timing.late_us == sampled
    assert abs(sampled - requested % WRAP_US) <= 3


def test_the_time_beyond_the_fastest_poll_is_uncertainty():
    timing = PollTiming(0, WIRE_US)
    timing.record(0, 10, 10 + WIRE_US + 20)
    timing.record(1000, 1010, 1010 + WIRE_US + 75)
    assert (timing.slack_us, timing.late_us - timing.early_us) == (55, 55)
    assert timing.early_us == 1010 + 20 + ADDRESS_US


def test_a_single_delay_of_a_millisecond_does_not_change_the_next_poll():
    timing = PollTiming(0, WIRE_US)
    timing.record(0, 1000, 1000 + WIRE_US)
    assert timing.due_us(10_000) == 10_000 - ADDRESS_US
