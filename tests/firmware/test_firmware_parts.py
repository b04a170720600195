"""Supervision of the chips: bus errors, silent or exchanged chips, lost settings."""

import errno
from types import SimpleNamespace

import pytest
from parts import Parts, default_batch
from wire import FAULT_BUS_STUCK, FAULT_IMU_SILENT, FAULT_POLLED_TOO_FAST, IMU_BATCH_MAX_ROWS

from fakes.fake_port import PORT_TICKS


class FakeBus:
    """A bus on which every chip answers with one id."""

    def __init__(self, who_am_i):
        self.who_am_i = who_am_i

    def readfrom_mem_into(self, address, register, one):
        one[0] = self.who_am_i


def reconfigure(who_am_i):
    """Reconfigure a chip of id 0x69 that lost its settings; `who_am_i` answers now. Return the actions."""
    actions = []
    fake = object.__new__(Parts)
    fake._board = SimpleNamespace(i2c=FakeBus(who_am_i))
    fake._sampler = SimpleNamespace(end=lambda: actions.append("sampling ends"))
    fake.chip = SimpleNamespace(
        i2c=fake._board.i2c,
        address=0x6B,
        WHO_AM_I_REGISTER=0x0F,
        who_am_i=0x69,
        intact=lambda: False,
        configure=lambda: actions.append("set up"),
    )
    fake.i2c_errors = 0
    fake._search = lambda: actions.append("search")
    fake.start = lambda lost: actions.append(("sampling begins", lost))
    assert fake._configure(False)
    return actions, fake.i2c_errors


@pytest.mark.parametrize(
    ("who_am_i", "actions", "errors"),
    [(0x69, ["set up", ("sampling begins", True)], 1), (0x6C, ["sampling ends", "search"], 0)],
)
def test_the_same_chip_is_reconfigured_and_another_one_is_searched_for(who_am_i, actions, errors):
    assert reconfigure(who_am_i) == (actions, errors)


def parts_whose_bus_fails(who_am_i=0x69, free=True):
    """Return parts on a failing bus and their list of actions; None for `who_am_i`: the chip is silent."""
    actions = []
    fake = object.__new__(Parts)

    def intact():
        if who_am_i is None:
            raise OSError(19)
        return True

    board = SimpleNamespace(i2c="fresh", free_bus=lambda: actions.append("free") or free)
    fake._board, fake._sampler = board, SimpleNamespace(due_us=0)
    fake.chip = SimpleNamespace(i2c="old", address=0x6B, intact=intact)
    fake.mag = SimpleNamespace(i2c="old", address=0x1E)
    fake.i2c_errors = fake.recoveries = fake.faults = fake.failures = 0
    fake.paused = False
    fake._silent = lambda now: True
    return fake, actions


def test_a_bus_is_freed_after_several_errors_in_a_row_or_at_once_after_a_timeout():
    fake, actions = parts_whose_bus_fails()
    freed_at = next(k for k in range(1, 50) if fake.handle_bus_error(OSError(5), 1000) or actions)
    assert 1 < freed_at < 20
    assert (fake.i2c_errors, fake.recoveries, fake.failures) == (freed_at, 1, 0)
    assert fake.chip.i2c == fake.mag.i2c == "fresh"
    assert not fake.paused and not fake.faults
    fake.handle_bus_error(OSError(errno.ETIMEDOUT), 1000)
    assert (fake.i2c_errors, fake.recoveries, actions) == (freed_at + 1, 2, ["free", "free"])
    fake.handle_bus_error(MemoryError(), 1000)
    assert (fake.recoveries, fake.failures) == (2, 1), (
        "an error without arguments does not free the bus at once"
    )
    fake._silent = lambda now: False
    for _ in range(50):
        fake.handle_bus_error(OSError(5), 1000)
    assert fake.recoveries == 2, "while samples arrive, errors are only counted"


@pytest.mark.parametrize(("who_am_i", "free", "errors"), [(0x69, False, 1), (None, True, 2)])
def test_a_stuck_bus_and_a_silent_chip_are_paused(who_am_i, free, errors):
    fake, _ = parts_whose_bus_fails(who_am_i, free)
    fake.handle_bus_error(OSError(errno.ETIMEDOUT), 1000)
    assert fake.paused and fake.i2c_errors == errors
    assert bool(fake.faults & FAULT_BUS_STUCK) == (not free)
    stuck = fake.faults
    fake._board.free_bus = lambda: True
    fake.handle_bus_error(OSError(errno.ETIMEDOUT), 1000)
    assert stuck == (0 if free else FAULT_BUS_STUCK) and fake.faults == 0, "the fault ends with its cause"


def parts_that_sample(period_us=4800, discarded=0):
    """Return parts whose IMU gave its last sample at 10 s, and their list of actions."""
    actions = []
    fake = object.__new__(Parts)
    fake._sampler = SimpleNamespace(
        clock=SimpleNamespace(period_us=period_us), last_us=10_000_000, due_us=10_004_800, discarded=discarded
    )
    fake.chip = SimpleNamespace(uses_fifo=False, rate_mhz=208_000)
    fake.faults = fake.failures = fake._discarded = fake._check_us = fake._settings_ms = fake._search_ms = 0
    fake._since_us, fake._check_us, fake._start_us = 10_000_000, 10_000_000, 9_000_000
    fake._pause_us, fake.paused, fake._too_fast = 0, False, False
    fake._configure = lambda always: actions.append(("revive", always))
    fake._search = lambda: actions.append("search")
    return fake, actions


@pytest.mark.parametrize(("period_us", "limit_us"), [(4800, 100_000), (10_000, 100_000), (80_000, 800_000)])
def test_a_chip_without_samples_for_a_tenth_of_a_second_or_ten_periods_is_silent(period_us, limit_us):
    fake, actions = parts_that_sample(period_us)
    fake.faults, fake.failures = FAULT_BUS_STUCK | FAULT_IMU_SILENT, 2
    fake._watch_imu(10_000_000 + limit_us - 1)
    assert (actions, fake.faults, fake.failures) == ([], FAULT_BUS_STUCK, 0)
    fake._watch_imu(10_000_000 + limit_us)
    assert actions == [("revive", False)] and fake.faults == FAULT_BUS_STUCK | FAULT_IMU_SILENT


def test_a_chip_that_was_configured_again_stays_silent_until_its_next_sample():
    fake, _ = parts_that_sample()
    fake._watch_imu(10_100_000)
    fake._sampler.last_us = fake._start_us = 10_100_000
    fake._watch_imu(10_150_000)
    assert fake.faults == FAULT_IMU_SILENT
    fake._sampler.last_us = 10_150_000
    fake._watch_imu(10_150_000)
    assert not fake.faults


def test_a_silent_chip_is_polled_ten_times_per_second_and_reconfigured_every_second():
    fake, actions = parts_that_sample()
    for ms in range(0, 2500, 10):
        fake._watch_imu(10_000_000 + 1000 * ms)
    assert len(actions) == 24, "ten times per second from 0.1 s on"
    assert [k for k, (_, always) in enumerate(actions) if always] == [10, 21]


def test_the_chip_settings_are_checked_every_second_between_samples_or_50_ms_late():
    fake, actions = parts_that_sample()
    PORT_TICKS.now_us = 10_000_000
    fake._settings_ms = 10_000
    for due_us, ms, checked in (
        (10_001_499, 10_000, False),
        (10_001_499, 10_049, False),
        (10_001_499, 10_050, True),
        (10_001_500, 10_000, True),
    ):
        actions.clear()
        fake._settings_ms, fake._sampler.due_us = 10_000, due_us
        fake._check_settings(ms)
        assert actions == ([("revive", False)] if checked else [])
        assert fake._settings_ms == (ms + 1000 if checked else 10_000)
    fake.chip.uses_fifo, fake._settings_ms = True, 10_000
    fake._check_settings(10_000)
    assert fake._settings_ms == 11_000, "with a FIFO the check delays no sample"


def test_polling_ends_if_more_than_one_sample_in_sixteen_is_discarded():
    """At 208 Hz, 13 samples discarded per second are one in sixteen."""
    for before, discarded, ends in ((0, 13, False), (0, 14, True), (100, 113, False), (100, 114, True)):
        fake, actions = parts_that_sample(discarded=discarded)
        fake._discarded = before
        fake._sampler.due_us = 10_100_000
        PORT_TICKS.now_us = 10_000_000
        fake._check_settings(0)
        assert actions == (["search"] if ends else [("revive", False)])
        assert fake._too_fast == ends and bool(fake.faults & FAULT_POLLED_TOO_FAST) == ends
        assert fake._discarded == discarded


def test_supervision_depends_on_the_state_of_bus_and_chip():
    fake, actions = parts_that_sample()
    PORT_TICKS.now_us = fake._sampler.last_us = 10_000_000
    fake._sampler.due_us = 10_100_000
    fake._settings_ms = 500
    for ms in (499, 500):
        fake.supervise(ms, True)
    assert actions == [("revive", False)]
    fake.paused, fake._pause_us, fake._settings_ms = True, 10_000_001, 0
    fake.supervise(2000, True)
    assert fake.paused and len(actions) == 1, "a stuck bus is paused"
    PORT_TICKS.now_us += 1
    fake.supervise(2000, True)
    assert not fake.paused and len(actions) == 2
    fake.chip, fake._search_ms = None, 2000
    for ms, running in ((2999, True), (3000, False), (3000, True)):
        fake.supervise(ms, running)
    assert actions[2:] == ["search"]


@pytest.mark.parametrize(
    ("rate_mhz", "rows"),
    [(104_000, 8), (250_000, 8), (416_000, 16), (1_000_000, 16), (1_660_000, IMU_BATCH_MAX_ROWS)],
)
def test_the_default_batch_lasts_about_40_ms_or_fills_a_frame(rate_mhz, rows):
    assert default_batch(rate_mhz) == rows
