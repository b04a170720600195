"""What becomes of sampling when the chip on the bus is not the one that was set up."""

import errno
from types import SimpleNamespace

import pytest
from parts import Parts, default_batch
from wire import FAULT_BUS_STUCK, FAULT_IMU_SILENT, FAULT_POLLED_TOO_FAST, IMU_BATCH_MAX_ROWS

from fakes.fake_port import PORT_TICKS


class FakeBus:
    """Every chip on it answers with one id."""

    def __init__(self, who_am_i):
        self.who_am_i = who_am_i

    def readfrom_mem_into(self, address, register, one):
        one[0] = self.who_am_i


def look_again(who_am_i):
    """What parts do, in order, with a chip of id 0x69 that lost its settings where `who_am_i` answers now."""
    done = []
    made = object.__new__(Parts)
    made._board = SimpleNamespace(i2c=FakeBus(who_am_i))
    made._sampler = SimpleNamespace(end=lambda: done.append("sampling ends"))
    made.chip = SimpleNamespace(
        address=0x6B,
        WHO_AM_I_REGISTER=0x0F,
        who_am_i=0x69,
        intact=lambda: False,
        configure=lambda: done.append("set up"),
    )
    made.i2c_errors = 0
    made._search = lambda: done.append("search")
    made.start = lambda lost: done.append(("sampling begins", lost))
    assert made._configure(False)
    return done, made.i2c_errors


@pytest.mark.parametrize(
    ("who_am_i", "done", "errors"),
    [(0x69, ["set up", ("sampling begins", True)], 1), (0x6C, ["sampling ends", "search"], 0)],
)
def test_the_same_chip_is_set_up_again_and_of_another_no_sample_is_taken(who_am_i, done, errors):
    assert look_again(who_am_i) == (done, errors)


def parts_whose_bus_fails(who_am_i=0x69, free=True):
    """With what is done in order; a chip that was set up does not answer where `who_am_i` is None."""
    done = []
    made = object.__new__(Parts)

    def intact():
        if who_am_i is None:
            raise OSError(19)
        return True

    board = SimpleNamespace(i2c="fresh", free_bus=lambda: done.append("free") or free)
    made._board, made._sampler = board, SimpleNamespace(due_us=0)
    made.chip = SimpleNamespace(i2c="old", intact=intact)
    made.mag = SimpleNamespace(i2c="old")
    made.i2c_errors = made.recoveries = made.faults = made.failures = 0
    made.paused = False
    made._silent = lambda now: True
    return made, done


def test_a_bus_is_freed_after_a_few_errors_in_a_row_or_at_once_where_one_timed_out():
    made, done = parts_whose_bus_fails()
    freed_at = next(k for k in range(1, 50) if made.bus_error(OSError(5), 1000) or done)
    assert 1 < freed_at < 20
    assert (made.i2c_errors, made.recoveries, made.failures) == (freed_at, 1, 0)
    assert made.chip.i2c == made.mag.i2c == "fresh"
    assert not made.paused and not made.faults
    made.bus_error(OSError(errno.ETIMEDOUT), 1000)
    assert (made.i2c_errors, made.recoveries, done) == (freed_at + 1, 2, ["free", "free"])
    made.bus_error(MemoryError(), 1000)
    assert (made.recoveries, made.failures) == (2, 1), "an error without arguments is one of many"
    made._silent = lambda now: False
    for _ in range(50):
        made.bus_error(OSError(5), 1000)
    assert made.recoveries == 2, "while samples come errors are counted alone"


@pytest.mark.parametrize(("who_am_i", "free", "errors"), [(0x69, False, 1), (None, True, 2)])
def test_a_bus_that_stays_stuck_and_a_chip_that_stays_silent_are_left_alone_for_a_while(
    who_am_i, free, errors
):
    made, _ = parts_whose_bus_fails(who_am_i, free)
    made.bus_error(OSError(errno.ETIMEDOUT), 1000)
    assert made.paused and made.i2c_errors == errors
    assert bool(made.faults & FAULT_BUS_STUCK) == (not free)
    stuck = made.faults
    made._board.free_bus = lambda: True
    made.bus_error(OSError(errno.ETIMEDOUT), 1000)
    assert stuck == (0 if free else FAULT_BUS_STUCK) and made.faults == 0, "and the fault ends with the cause"


def parts_that_sample(period_us=4800, discarded=0):
    """Parts with an IMU that has given its last sample at 10 s, and what they do about it: `done`."""
    done = []
    made = object.__new__(Parts)
    made._sampler = SimpleNamespace(
        clock=SimpleNamespace(period_us=period_us), last_us=10_000_000, due_us=10_004_800, discarded=discarded
    )
    made.chip = SimpleNamespace(uses_fifo=False, rate_mhz=208_000)
    made.faults = made.failures = made._discarded = made._check_us = made._settings_ms = made._search_ms = 0
    made._since_us, made._check_us = 10_000_000, 10_000_000
    made._pause_us, made.paused, made._too_fast = 0, False, False
    made._configure = lambda always: done.append(("revive", always))
    made._search = lambda: done.append("search")
    return made, done


@pytest.mark.parametrize(("period_us", "limit_us"), [(4800, 100_000), (10_000, 100_000), (80_000, 800_000)])
def test_a_chip_without_samples_for_a_tenth_of_a_second_or_ten_periods_is_silent(period_us, limit_us):
    made, done = parts_that_sample(period_us)
    made.faults, made.failures = FAULT_BUS_STUCK | FAULT_IMU_SILENT, 2
    made._watch_imu(10_000_000 + limit_us - 1)
    assert (done, made.faults, made.failures) == ([], FAULT_BUS_STUCK, 0)
    made._watch_imu(10_000_000 + limit_us)
    assert done == [("revive", False)] and made.faults == FAULT_BUS_STUCK | FAULT_IMU_SILENT


def test_a_silent_chip_is_asked_ten_times_a_second_and_set_up_anyhow_every_second():
    made, done = parts_that_sample()
    for ms in range(0, 2500, 10):
        made._watch_imu(10_000_000 + 1000 * ms)
    assert len(done) == 24, "from 0.1 s on"
    assert [k for k, (_, always) in enumerate(done) if always] == [10, 21]


def test_the_settings_are_looked_at_every_second_between_two_samples_or_a_little_late():
    made, done = parts_that_sample()
    PORT_TICKS.now_us = 10_000_000
    made._settings_ms = 10_000
    for due_us, ms, looked in (
        (10_001_499, 10_000, False),
        (10_001_499, 10_049, False),
        (10_001_499, 10_050, True),
        (10_001_500, 10_000, True),
    ):
        done.clear()
        made._settings_ms, made._sampler.due_us = 10_000, due_us
        made._check_settings(ms)
        assert done == ([("revive", False)] if looked else [])
        assert made._settings_ms == (ms + 1000 if looked else 10_000)
    made.chip.uses_fifo, made._settings_ms = True, 10_000
    made._check_settings(10_000)
    assert made._settings_ms == 11_000, "from the FIFO no sample is late"


def test_polling_that_gives_up_more_than_one_sample_in_sixteen_ends():
    """208 Hz, looked at every second: 13 of 208 are one in sixteen."""
    for before, discarded, ends in ((0, 13, False), (0, 14, True), (100, 113, False), (100, 114, True)):
        made, done = parts_that_sample(discarded=discarded)
        made._discarded = before
        made._sampler.due_us = 10_100_000
        PORT_TICKS.now_us = 10_000_000
        made._check_settings(0)
        assert done == (["search"] if ends else [("revive", False)])
        assert made._too_fast == ends and bool(made.faults & FAULT_POLLED_TOO_FAST) == ends
        assert made._discarded == discarded


def test_what_is_looked_after_depends_on_what_is_there():
    made, done = parts_that_sample()
    PORT_TICKS.now_us = made._sampler.last_us = 10_000_000
    made._sampler.due_us = 10_100_000
    made._settings_ms = 500
    for ms in (499, 500):
        made.supervise(ms, True)
    assert done == [("revive", False)]
    made.paused, made._pause_us, made._settings_ms = True, 10_000_001, 0
    made.supervise(2000, True)
    assert made.paused and len(done) == 1, "a bus that stays stuck is left alone"
    PORT_TICKS.now_us += 1
    made.supervise(2000, True)
    assert not made.paused and len(done) == 2
    made.chip, made._search_ms = None, 2000
    for ms, running in ((2999, True), (3000, False), (3000, True)):
        made.supervise(ms, running)
    assert done[2:] == ["search"]


@pytest.mark.parametrize(
    ("rate_mhz", "rows"),
    [(104_000, 8), (250_000, 8), (416_000, 16), (1_000_000, 16), (1_660_000, IMU_BATCH_MAX_ROWS)],
)
def test_a_batch_is_of_some_forty_milliseconds_or_a_full_frame(rate_mhz, rows):
    assert default_batch(rate_mhz) == rows
