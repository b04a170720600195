"""The daemon's clock: wall clock time without steps, optionally slowed."""

import pytest

from hubodo.cli import main
from hubodo.ingest.live import computer
from hubodo.ingest.live.host_clock import HostClock
from hubodo.units import NS_PER_S


@pytest.fixture
def passing(monkeypatch):
    """Set the elapsed time of the host's clocks, s; asleep: duration of suspension in it."""
    wall, monotonic = 1_700_000_000 * NS_PER_S, 5_000 * NS_PER_S
    now = {"wall": wall, "monotonic": monotonic}
    monkeypatch.setattr(computer.time, "time_ns", lambda: now["wall"])
    monkeypatch.setattr(computer.time, "monotonic_ns", lambda: now["monotonic"])
    monkeypatch.setattr(computer.time, "CLOCK_BOOTTIME", 7, raising=False)
    monkeypatch.setattr(computer.time, "clock_gettime_ns", lambda clock: now["boot"])
    now["boot"] = monotonic

    def advance(seconds, step=0.0, asleep=0.0):
        now["wall"] = wall + int((seconds + step) * NS_PER_S)
        now["monotonic"] = monotonic + int((seconds - asleep) * NS_PER_S)
        now["boot"] = monotonic + int(seconds * NS_PER_S)

    return advance


def test_a_step_of_the_wall_clock_has_no_effect(passing):
    clock = computer.steady_clock()
    start = clock()
    passing(3.0, step=60.0)
    assert clock() - start == 3 * NS_PER_S


def test_elapsed_time_continues_while_the_computer_is_suspended(passing):
    clock = computer.steady_clock()
    start = clock()
    passing(603.0, asleep=600.0)
    assert clock() - start == 603 * NS_PER_S


def test_a_slowed_clock_is_slow_from_its_start_on(passing):
    clock = computer.steady_clock(2.0)
    start = clock()
    passing(3.0)
    assert clock() - start == 3 * NS_PER_S // 2


def test_slewed_time_is_not_reported_as_a_clock_step(passing):
    slowed = computer.ThisComputer(2.0)
    clock, events = HostClock(slowed), []
    for second in range(10):
        passing(second)
        events += clock.tick(slowed.now_ns())
    assert [event.data for event in events if "step_s" in event.data] == []


def test_a_clock_that_does_not_advance_is_refused(tmp_path, capfd):
    words = ["record", str(tmp_path / "ttyNONE"), "-o", str(tmp_path / "x.mcap"), "--time-scale", "0"]
    assert main(words) == 2
    assert "--time-scale: 0: write a number above 0" in capfd.readouterr().err
