"""Scheduled events of an emulated board: order of faults, stalls, watchdog and end of the run."""

import struct

from hubodo.emulator.board.clock import FOREVER
from hubodo.emulator.board.hypercall import Op
from hubodo.emulator.board.schedule import EventSchedule
from hubodo.emulator.chips.faults import BrownOut, BusNack, Reset, Stall, Unplug

SECOND = 1_000_000_000


def test_without_events_nothing_is_due() -> None:
    schedule = EventSchedule((), None)
    assert schedule.next_time == schedule.quiet_until == FOREVER
    assert schedule.pop_due_fault(1e18) is None


def test_faults_of_the_processor_come_in_order_of_time_and_those_of_chips_not_at_all() -> None:
    reset, unplug, brown_out = Reset(3.0), Unplug(1.0, 0.5), BrownOut(2.0)
    faults = (reset, BusNack(0.5), brown_out, BrownOut(0.1, "chips"), unplug)
    schedule = EventSchedule(faults, 10.0)
    assert schedule.next_time == 1.0 * SECOND
    assert schedule.pop_due_fault(0.999 * SECOND) is None
    assert [schedule.pop_due_fault(5.0 * SECOND) for _ in range(4)] == [unplug, brown_out, reset, None]
    assert schedule.next_time == 10.0 * SECOND


def test_stalls_that_begin_within_another_stall_follow_it() -> None:
    schedule = EventSchedule((Stall(2.0, 0.5), Stall(1.0, 1.2), Stall(9.0, 1.0)), None)
    assert schedule.quiet_until == 1.0 * SECOND and schedule.next_time == FOREVER
    assert schedule.apply_stalls(0.5 * SECOND) == (0, 0.5 * SECOND)
    # The first stall delays the call from 1.0 to 2.2 s, when the second stall has begun.
    assert schedule.apply_stalls(1.0 * SECOND) == (2, 2.7 * SECOND)
    assert schedule.quiet_until == 9.0 * SECOND


def test_the_watchdog_is_due_a_timeout_after_it_was_last_fed() -> None:
    schedule = EventSchedule((), None)
    watchdog = schedule.handlers()[Op.WDT]
    # Feeding a watchdog that was not started has no effect.
    watchdog(0, b"", 1.0 * SECOND)
    assert schedule.next_time == FOREVER
    watchdog(1, struct.pack("<I", 2000), 1.0 * SECOND)
    assert schedule.watchdog_at == 3.0 * SECOND
    watchdog(0, b"", 2.5 * SECOND)
    assert schedule.next_time == 4.5 * SECOND
    schedule.stop_watchdog()
    watchdog(0, b"", 2.6 * SECOND)
    assert schedule.next_time == FOREVER
