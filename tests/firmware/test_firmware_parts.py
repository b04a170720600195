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
    fake = object.__new__(Parts)
    fake._board = SimpleNamespace(i2c=FakeBus(who_am_i))
    fake._sampler = SimpleNamespace(end=lambda: done.append("sampling ends"))
    fake.chip = SimpleNamespace(
        address=0x6B,
        WHO_AM_I_REGISTER=0x0F,
        who_am_i=0x69,
        intact=lambda: False,
        configure=lambda: done.append("set up"),
    )
    fake.i2c_errors = 0
    fake._search = lambda: done.append("search")
    fake.start = lambda lost: done.append(("sampling begins", lost))
    assert fake._configure(False)
    return done, fake.i2c_errors


@pytest.mark.parametrize(
    ("who_am_i", "done", "errors"),
    [(0x69, ["set up", ("sampling begins", True)], 1), (0x6C, ["sampling ends", "search"], 0)],
)
def test_the_same_chip_is_set_up_again_and_of_another_no_sample_is_taken(who_am_i, done, errors):
    assert look_again(who_am_i) == (done, errors)


def parts_whose_bus_fails(who_am_i=0x69, free=True):
    """With what is done in order; a chip that was set up does not answer where `who_am_i` is None."""
    done = []
    fake = object.__new__(Parts)

    def intact():
        if who_am_i is None:
            raise OSError(19)
        return True

    board = SimpleNamespace(i2c="fresh", free_bus=lambda: done.append("free") or free)
    fake._board, fake._sampler = board, SimpleNamespace(due_us=0)
    fake.chip = SimpleNamespace(i2c="old", intact=intact)
    fake.mag = SimpleNamespace(i2c="old")
    fake.i2c_errors = fake.recoveries = fake.faults = fake.failures = 0
    fake.paused = False
    fake._silent = lambda now: True
    return fake, done


def test_a_bus_is_freed_after_a_few_errors_in_a_row_or_at_once_where_one_timed_out():
    fake, done = parts_whose_bus_fails()
    freed_at = next(k for k in range(1, 50) if fake.bus_error(OSError(5), 1000) or done)
    assert 1 < freed_at < 20
    assert (fake.i2c_errors, fake.recoveries, fake.failures) == (freed_at, 1, 0)
    assert fake.chip.i2c == fake.mag.i2c == "fresh"
    assert not fake.paused and not fake.faults
    fake.bus_error(OSError(errno.ETIMEDOUT), 1000)
    assert (fake.i2c_errors, fake.recoveries, done) == (freed_at + 1, 2, ["free", "free"])
    fake.bus_error(MemoryError(), 1000)
    assert (fake.recoveries, fake.failures) == (2, 1), "an error without arguments is one of many"
    fake._silent = lambda now: False
    for _ in range(50):
        fake.bus_error(OSError(5), 1000)
    assert fake.recoveries == 2, "while samples come errors are counted alone"


@pytest.mark.parametrize(("who_am_i", "free", "errors"), [(0x69, False, 1), (None, True, 2)])
def test_a_bus_that_stays_stuck_and_a_chip_that_stays_silent_are_left_alone_for_a_while(
    who_am_i, free, errors
):
    fake, _ = parts_whose_bus_fails(who_am_i, free)
    fake.bus_error(OSError(errno.ETIMEDOUT), 1000)
    assert fake.paused and fake.i2c_errors == errors
    assert bool(fake.faults & FAULT_BUS_STUCK) == (not free)
    stuck = fake.faults
    fake._board.free_bus = lambda: True
    fake.bus_error(OSError(errno.ETIMEDOUT), 1000)
    assert stuck == (0 if free else FAULT_BUS_STUCK) and fake.faults == 0, "and the fault ends with the cause"


def parts_that_sample(period_us=4800, discarded=0):
    """Parts with an IMU that has given its last sample at 10 s, and what they do about it: `done`."""
    done = []
    fake = object.__new__(Parts)
    fake._sampler = SimpleNamespace(
        clock=SimpleNamespace(period_us=period_us), last_us=10_000_000, due_us=10_004_800, discarded=discarded
    )
    fake.chip = SimpleNamespace(uses_fifo=False, rate_mhz=208_000)
    fake.faults = fake.failures = fake._discarded = fake._check_us = fake._settings_ms = fake._search_ms = 0
    fake._since_us, fake._check_us = 10_000_000, 10_000_000
    fake._pause_us, fake.paused, fake._too_fast = 0, False, False
    fake._configure = lambda always: done.append(("revive", always))
    fake._search = lambda: done.append("search")
    return fake, done


@pytest.mark.parametrize(("period_us", "limit_us"), [(4800, 100_000), (10_000, 100_000), (80_000, 800_000)])
def test_a_chip_without_samples_for_a_tenth_of_a_second_or_ten_periods_is_silent(period_us, limit_us):
    fake, done = parts_that_sample(period_us)
    fake.faults, fake.failures = FAULT_BUS_STUCK | FAULT_IMU_SILENT, 2
    fake._watch_imu(10_000_000 + limit_us - 1)
    assert (done, fake.faults, fake.failures) == ([], FAULT_BUS_STUCK, 0)
    fake._watch_imu(10_000_000 + limit_us)
    assert done == [("revive", False)] and fake.faults == FAULT_BUS_STUCK | FAULT_IMU_SILENT


def test_a_silent_chip_is_asked_ten_times_a_second_and_set_up_anyhow_every_second():
    fake, done = parts_that_sample()
    for ms in range(0, 2500, 10):
        fake._watch_imu(10_000_000 + 1000 * ms)
    assert len(done) == 24, "from 0.1 s on"
    assert [k for k, (_, always) in enumerate(done) if always] == [10, 21]


def test_the_settings_are_looked_at_every_second_between_two_samples_or_a_little_late():
    fake, done = parts_that_sample()
    PORT_TICKS.now_us = 10_000_000
    fake._settings_ms = 10_000
    for due_us, ms, checked in (
        (10_001_499, 10_000, False),
        (10_001_499, 10_049, False),
        (10_001_499, 10_050, True),
        (10_001_500, 10_000, True),
    ):
        done.clear()
        fake._settings_ms, fake._sampler.due_us = 10_000, due_us
        fake._check_settings(ms)
        assert done == ([("revive", False)] if checked else [])
        assert fake._settings_ms == (ms + 1000 if checked else 10_000)
    fake.chip.uses_fifo, fake._settings_ms = True, 10_000
    fake._check_settings(10_000)
    assert fake._settings_ms == 11_000, "from the FIFO no sample is late"


def test_polling_that_gives_up_more_than_one_sample_in_sixteen_ends():
    """208 Hz, looked at every second: 13 of 208 are one in sixteen."""
    for before, discarded, ends in ((0, 13, False), (0, 14, True), (100, 113, False), (100, 114, True)):
        fake, done = parts_that_sample(discarded=discarded)
        fake._discarded = before
        fake._sampler.due_us = 10_100_000
        PORT_TICKS.now_us = 10_000_000
        fake._check_settings(0)
        assert done == (["search"] if ends else [("revive", False)])
        assert fake._too_fast == ends and bool(fake.faults & FAULT_POLLED_TOO_FAST) == ends
        assert fake._discarded == discarded


def test_what_is_looked_after_depends_on_what_is_there():
    fake, done = parts_that_sample()
    PORT_TICKS.now_us = fake._sampler.last_us = 10_000_000
    fake._sampler.due_us = 10_100_000
    fake._settings_ms = 500
    for ms in (499, 500):
        fake.supervise(ms, True)
    assert done == [("revive", False)]
    fake.paused, fake._pause_us, fake._settings_ms = True, 10_000_001, 0
    fake.supervise(2000, True)
    assert fake.paused and len(done) == 1, "a bus that stays stuck is left alone"
    PORT_TICKS.now_us += 1
    fake.supervise(2000, True)
    assert not fake.paused and len(done) == 2
    fake.chip, fake._search_ms = None, 2000
    for ms, running in ((2999, True), (3000, False), (3000, True)):
        fake.supervise(ms, running)
    assert done[2:] == ["search"]


@pytest.mark.parametrize(
    ("rate_mhz", "rows"),
    [(104_000, 8), (250_000, 8), (416_000, 16), (1_000_000, 16), (1_660_000, IMU_BATCH_MAX_ROWS)],
)
def test_a_batch_is_of_some_forty_milliseconds_or_a_full_frame(rate_mhz, rows):
    assert default_batch(rate_mhz) == rows
