"""Sampler and queue with the emulated chips, on CPython: gaps are numbered, no sample is invented."""

import random
import time
from functools import partial

import fifo_samples
import native
import numpy as np
import outbox as outbox_module
import polled_samples
import pytest
import sampler
from drivers.bmi088 import BMI088
from drivers.lsm6ds33 import LSM6DS33
from drivers.lsm6dso import LSM6DSO
from drivers.mpu6050 import MPU6050
from emulated_bus import EmulatedBus
from outbox import Outbox

import hubowire
from fakes import fake_port
from fakes.fake_port import PORT_TICKS
from hubodo.emulator.chips.bmi088 import Bmi088
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.lsm6ds33 import Lsm6ds33
from hubodo.emulator.chips.lsm6dso import Lsm6dso
from hubodo.emulator.chips.mpu6050 import Mpu6050
from hubowire import messages as m
from repetitions import first_and_more
from virtual_runs import match_samples, unique_motion

CHIPS = {"lsm6ds33": (Lsm6ds33, LSM6DS33), "lsm6dso": (Lsm6dso, LSM6DSO), "mpu6050": (Mpu6050, MPU6050)}
CHIPS["bmi088"] = Bmi088, partial(BMI088, range_g=3)


class SamplerRun:
    """A driver and a sampler on an emulated chip; `sent` has the messages for the link."""

    def __init__(self, monkeypatch, chip, rate, seconds, *, turn_us=200, fifo=False, odr_error=0.02, **bus):
        silicon, driver = CHIPS[chip]
        self.chip = silicon(unique_motion(seconds + 1), Specimen(odr_error=odr_error))
        self.bus = EmulatedBus(self.chip, **bus)
        self.seconds, self.turn_us = seconds, turn_us
        for module in (sampler, fifo_samples, polled_samples):
            monkeypatch.setattr(module, "ticks_us", self.bus.ticks_us)
        self.outbox = Outbox(24, 1)
        self.driver = driver(self.bus, odr_hz=rate, fifo=fifo)
        batch = 16 if rate > 250 else 8
        self.outbox.shape(batch)
        self.sampler = sampler.Sampler(self.outbox, lambda *_: None)
        self.sampler.start(self.bus.ticks_us(), self.driver, batch, False)
        self.sent = []

    def run(self, each_turn=lambda t: None):
        decoder = hubowire.FrameDecoder()
        while self.bus.t < self.seconds:
            self.sampler.step(self.bus.ticks_us())
            while (slot := self.outbox.oldest()) is not None:
                wire = bytes(slot.raw[1 + self.outbox.sent : slot.end])
                self.sent += [(f, hubowire.decode(f.type_id, f.payload)) for f in decoder.feed(wire)]
                self.outbox.advance(len(wire))
            self.bus.advance_time(self.turn_us)
            each_turn(self.bus.t)
            ahead = time.ticks_diff(self.sampler.due_us, self.bus.ticks_us()) - 300
            PORT_TICKS.now_us += min(max(ahead, 0), 1000)
        return self

    def missed_before_last_batch(self, jump):
        """Return the count of missed samples without those after the last batch."""
        last = self.sent[0][1].index + len(jump) + jump.sum()
        assert (last - self.sent[-1][1].index) % 65536 == len(self.sent[-1][1].samples) - 1
        waiting = self.sampler.count + self.sampler.reader.left
        return self.sampler.missed - (self.sampler.clock.index - last - waiting)

    def gaps(self):
        """Return index in the truth, samples missing after it, the same by number, and time error in us."""
        truth = self.chip.truth()
        matches = match_samples(self.sent, truth, round(self.bus.zero_us) % fake_port.TICKS)
        is_flagged = [
            i == 0 and bool(batch.flags & m.BatchFlag.GAP_BEFORE)
            for _, batch in self.sent
            for i in range(len(batch.samples))
        ]
        number = np.unwrap(matches[:, 2], period=65536)
        missing, jump = np.diff(matches[:, 0]) - 1, np.diff(number) - 1
        assert np.all(np.array(is_flagged)[1:][(missing > 0) | (jump > 0)]), (
            "every gap and every jump of the numbers is flagged"
        )
        return matches[:, 0].astype(int), missing, jump, matches[:, 1]


def test_a_fifo_poll_delayed_by_more_than_half_a_period_is_repeated(monkeypatch):
    """Every tenth poll takes 0.8 periods longer: it is repeated and does not update the clock."""
    sampler_run, n_polls, widths = SamplerRun(monkeypatch, "lsm6ds33", 416, 5), 0, []
    level, update = sampler_run.driver.fifo_level, sampler_run.sampler.clock.update

    def delayed_level():
        nonlocal n_polls
        n_polls += 1
        fifo_level = level()
        sampler_run.bus.advance_time(1920 if n_polls > 100 and n_polls % 10 == 0 else 0)
        return fifo_level

    def recording_update(early_us, late_us, samples):
        if n_polls > 100:
            widths.append(time.ticks_diff(late_us, early_us))
        update(early_us, late_us, samples)

    monkeypatch.setattr(sampler_run.driver, "fifo_level", delayed_level)
    monkeypatch.setattr(sampler_run.sampler.clock, "update", recording_update)
    sampler_run.run()
    print(f"{n_polls} looks, {len(widths)} of them used, uncertainty up to {max(widths)} us")
    assert len(widths) > 50 and max(widths) < 1202


@pytest.mark.parametrize("seed", first_and_more(1, 2, 3, 4))
@pytest.mark.parametrize(
    ("chip", "rate", "stalls"),
    [
        ("lsm6ds33", 104, (0.05, 0.01)),
        ("lsm6ds33", 208, (0.1, 0.03)),
        ("lsm6ds33", 208, (0.5, 0.2)),
        ("lsm6ds33", 416, (0.05, 0.1)),
        ("lsm6ds33", 1660, (0.02, 0.1)),
        ("mpu6050", 200, (0.2, 0.1)),
        ("mpu6050", 1000, (0.02, 0.02)),
    ],
)
def test_stalls_of_the_processor_never_shift_a_sample_number(monkeypatch, chip, rate, stalls, seed):
    """The processor stalls at random calls of bus and clock: each gap has its true size and position."""
    sampler_run = SamplerRun(monkeypatch, chip, rate, 8, stalls=stalls, seed=seed).run()
    k, missing, jump, error = sampler_run.gaps()
    print(
        f"seed {seed}: {sampler_run.bus.stalled_us / 1e6:.1f} s stalled, {missing.sum():.0f} of {k[-1]} lost"
    )
    assert sampler_run.bus.stalled_us > 50_000
    np.testing.assert_array_equal(jump, missing)
    assert jump.sum() == sampler_run.missed_before_last_batch(jump)
    assert np.abs(error[len(error) // 2 :]).max() < 500


@pytest.mark.parametrize(
    ("chip", "rate", "stalls"), [("lsm6dso", 208, (0.5, 0.2)), ("lsm6dso", 833, (0.05, 0.1))]
)
def test_stalls_never_shift_a_sample_number_of_the_other_chips(monkeypatch, chip, rate, stalls):
    test_stalls_of_the_processor_never_shift_a_sample_number(monkeypatch, chip, rate, stalls, 1)


@pytest.mark.parametrize(("chip", "rate", "turn_us"), [("lsm6ds33", 1660, 12_000), ("mpu6050", 1000, 20_000)])
def test_under_overload_the_missed_samples_equal_the_jumps_of_the_numbers(monkeypatch, chip, rate, turn_us):
    """The loop takes longer than a batch lasts, so that the FIFO overflows repeatedly."""
    sampler_run = SamplerRun(monkeypatch, chip, rate, 8, turn_us=turn_us).run()
    _, missing, jump, _ = sampler_run.gaps()
    assert sampler_run.sampler.overruns > 5 and missing.sum() > 2000
    assert jump.sum() == sampler_run.missed_before_last_batch(jump)
    assert jump.sum() == pytest.approx(missing.sum(), rel=0.005)


@pytest.mark.parametrize("words", range(1, 6))
def test_a_failed_fifo_read_loses_at_most_the_affected_samples(monkeypatch, words):
    """A failed burst removes words from the FIFO: its pattern shows where the next complete sample begins."""
    sampler_run = SamplerRun(monkeypatch, "lsm6ds33", 416, 4)
    at = [1.5, 2.5]

    def misread(t):
        if at and t > at[0] and sampler_run.sampler.reader.left:
            at.pop(0)
            sampler_run.bus.bus.read_mem(t, 0x6B, b"\x3e", 2 * words)

    sampler_run.run(misread)
    k, missing, jump, _ = sampler_run.gaps()
    assert not at
    assert sampler_run.driver.realigned == 2
    assert 2 <= missing.sum() <= 2 * 17
    assert np.abs(np.cumsum(jump) - np.cumsum(missing)).max() <= 1
    assert len(sampler_run.chip.truth().t) - k[-1] <= 17


def test_the_native_saturation_check_equals_the_plain_one():
    fast, rng = native.load(), random.Random(2)
    ends = (-32768, -32767, 32766, 32767)
    results = set()
    for _ in range(300):
        values = [rng.choice(ends) if rng.random() < 0.02 else rng.randrange(-9, 9) for _ in range(30)]
        at, last = sorted((rng.randrange(31), rng.randrange(31)))
        plain = sampler.saturated_plain(values, at, last)
        assert plain == any(v in (-32768, 32767) for v in values[at:last])
        # A 16-bit pointer is unsigned.
        assert bool(fast.saturated([v & 0xFFFF for v in values], at, last)) == plain
        results.add(plain)
    assert results == {True, False}


def create_outbox(depth, count):
    """Return an outbox after posting `count` frames with their number as payload."""
    box = Outbox(depth, 7)
    for number in range(count):
        slot = box.note()
        slot[outbox_module.PAYLOAD] = number & 0xFF
        box.post(5, 1)
    return box


def send_all(box):
    """Return (sequence number, payload) of all frames that the link still gets."""
    decoder, out = hubowire.FrameDecoder(), []
    while (slot := box.oldest()) is not None:
        wire = bytes(slot.raw[1 + box.sent : slot.end])
        out += [(f.seq, f.payload[0]) for f in decoder.feed(wire)]
        box.advance(len(wire))
    return out


@pytest.mark.parametrize("count", [0, 1, 3, 4, 5, 11, 300])
def test_the_queue_drops_the_oldest_frames_and_counts_them(count):
    box = create_outbox(4, count)
    assert (box.dropped, box.count, box.high_water) == (max(0, count - 4), min(count, 4), min(count, 4))
    assert send_all(box) == [(n, n & 0xFF) for n in range(max(0, count - 4), count)]
    assert (box.count, box.sent, box.high_water) == (0, 0 if count else -1, min(count, 4)), (
        "the high-water mark is unchanged"
    )


def test_a_partly_sent_frame_is_not_dropped():
    box = create_outbox(4, 4)
    first = bytes(box.oldest().raw[1 : box.oldest().end])
    box.advance(3)
    for _ in range(6):
        box.post(5, 1)
    assert box.dropped == 6
    assert bytes(box.oldest().raw[1 : box.oldest().end]) == first
    box.advance(len(first) - 3)
    assert [seq for seq, _ in send_all(box)] == [7, 8, 9]


@pytest.mark.parametrize(
    "rate, fifo", first_and_more((400, True), (100, True), (100, False), (200, True), (1000, True))
)
@pytest.mark.parametrize("odr_error", [0.02, -0.03])
def test_a_bmi088_pairs_each_sample_of_its_gyro_with_the_acceleration_of_that_time(
    monkeypatch, rate, fifo, odr_error
):
    """The clocks of its two chips drift apart by twice `odr_error`."""
    sampler_run = SamplerRun(monkeypatch, "bmi088", rate, 6, fifo=fifo, odr_error=odr_error)
    sampler_run.run()
    truth, accel_truth = sampler_run.chip.truth(), sampler_run.chip.accelerometer.clock.truth()
    rows = np.array([row for _, batch in sampler_run.sent for row in batch.samples])
    first = next(k for k in range(len(truth.raw)) if np.array_equal(truth.raw[k, :3], rows[0, :3]))
    assert len(rows) > 5.5 * rate
    assert np.array_equal(rows[:, :3], truth.raw[first : first + len(rows), :3])
    times = {}
    for t, words in zip(accel_truth.t, accel_truth.raw.tolist(), strict=True):
        times.setdefault(tuple(words), []).append(t)
    settled = range(rate, len(rows))
    late = [
        min((t - truth.t[first + k] for t in times[tuple(rows[k, 3:].tolist())]), key=abs) for k in settled
    ]
    period = 1 / {100: 200, 200: 400, 400: 800, 1000: 1600}[rate]
    print(
        f"accelerometer late by {np.mean(late):.6f} s, sd {np.std(late):.6f} s, {min(late):.6f} to "
        f"{max(late):.6f} s; its period is {period} s"
    )
    assert max(np.abs(late)) < 1.1 * period
    assert not fifo or abs(np.mean(late)) < 0.25 * period
