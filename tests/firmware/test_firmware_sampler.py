"""Sampler and queue against the emulated chips, on CPython: holes are numbered, nothing invented."""

import random
import time

import fifo_samples
import native
import numpy as np
import outbox as outbox_module
import polled_samples
import pytest
import sampler
from drivers.lsm6ds33 import LSM6DS33
from drivers.mpu6050 import MPU6050
from emulated_bus import EmulatedBus
from outbox import Outbox

import hubowire
from fakes import fake_port
from fakes.fake_port import PORT_TICKS
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.lsm6ds33 import Lsm6ds33
from hubodo.emulator.chips.mpu6050 import Mpu6050
from hubowire import messages as m
from virtual_runs import matched, unique_motion

CHIPS = {"lsm6ds33": (Lsm6ds33, LSM6DS33), "mpu6050": (Mpu6050, MPU6050)}


class Rig:
    """A driver and a sampler on an emulated chip; `sent` is what the link would carry."""

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
            self.bus.spend(self.turn_us)
            each_turn(self.bus.t)
            ahead = time.ticks_diff(self.sampler.due_us, self.bus.ticks_us()) - 300
            PORT_TICKS.now_us += min(max(ahead, 0), 1000)
        return self

    def missed_before_the_last(self, jump):
        """What was counted as missed, but for what was lost behind the last batch: no number shows it yet."""
        last = self.sent[0][1].index + len(jump) + jump.sum()
        assert (last - self.sent[-1][1].index) % 65536 == len(self.sent[-1][1].samples) - 1
        waiting = self.sampler.count + self.sampler._reader.left
        return self.sampler.missed - (self.sampler.clock.index - last - waiting)

    def holes(self):
        """(place in the truth, missing behind it, missing by number, time error in us) of every sample."""
        truth = self.chip.truth()
        found = matched(self.sent, truth, round(self.bus.zero_us) % fake_port.TICKS)
        says = [
            i == 0 and bool(batch.flags & m.BatchFlag.GAP_BEFORE)
            for _, batch in self.sent
            for i in range(len(batch.samples))
        ]
        number = np.unwrap(found[:, 2], period=65536)
        missing, jump = np.diff(found[:, 0]) - 1, np.diff(number) - 1
        assert np.all(np.array(says)[1:][(missing > 0) | (jump > 0)]), (
            "every hole and every jump is announced"
        )
        return found[:, 0].astype(int), missing, jump, found[:, 1]


def test_a_look_at_the_fifo_that_was_held_up_for_half_a_period_is_taken_again(monkeypatch):
    """Every tenth takes 0.8 periods longer: none of those tells the clock anything."""
    rig, looks, widths = Rig(monkeypatch, "lsm6ds33", 416, 5), 0, []
    level, seen = rig.driver.fifo_level, rig.sampler.clock.update

    def held_up():
        nonlocal looks
        looks += 1
        found = level()
        rig.bus.spend(1920 if looks > 100 and looks % 10 == 0 else 0)
        return found

    def recorded(early_us, late_us, samples):
        if looks > 100:
            widths.append(time.ticks_diff(late_us, early_us))
        seen(early_us, late_us, samples)

    monkeypatch.setattr(rig.driver, "fifo_level", held_up)
    monkeypatch.setattr(rig.sampler.clock, "update", recorded)
    rig.run()
    print(f"{looks} looks, {len(widths)} of them heard, known to {max(widths)} us")
    assert len(widths) > 50 and max(widths) < 1202


@pytest.mark.parametrize("seed", range(1, 5))
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
def test_a_processor_held_up_at_any_call_never_shifts_a_number(monkeypatch, chip, rate, stalls, seed):
    """Held up at random calls of bus and clock: each hole has the size it truly has, where it truly is."""
    rig = Rig(monkeypatch, chip, rate, 8, stalls=stalls, seed=seed).run()
    k, missing, jump, error = rig.holes()
    print(
        f"seed {seed}: {rig.bus.stalled_us / 1e6:.1f} s held up, {missing.sum():.0f} of {k[-1]} samples lost"
    )
    assert rig.bus.stalled_us > 50_000
    np.testing.assert_array_equal(jump, missing)
    assert jump.sum() == rig.missed_before_the_last(jump)
    assert np.abs(error[len(error) // 2 :]).max() < 500


@pytest.mark.parametrize(("chip", "rate", "turn_us"), [("lsm6ds33", 1660, 12_000), ("mpu6050", 1000, 20_000)])
def test_under_overload_what_is_counted_as_missed_is_what_the_numbers_skip(monkeypatch, chip, rate, turn_us):
    """The loop takes longer than a batch lasts: the FIFO overflows again and again."""
    rig = Rig(monkeypatch, chip, rate, 8, turn_us=turn_us).run()
    _, missing, jump, _ = rig.holes()
    assert rig.sampler.overruns > 5 and missing.sum() > 2000
    assert jump.sum() == rig.missed_before_the_last(jump)
    assert jump.sum() == pytest.approx(missing.sum(), rel=0.005)


@pytest.mark.parametrize("words", range(1, 6))
def test_a_misread_of_the_fifo_costs_at_most_the_samples_it_tore(monkeypatch, words):
    """Words that a failed burst took unseen: the pattern shows where the next whole sample begins."""
    rig = Rig(monkeypatch, "lsm6ds33", 416, 4)
    at = [1.5, 2.5]

    def misread(t):
        if at and t > at[0] and rig.sampler._reader.left:
            at.pop(0)
            rig.bus.bus.read_mem(t, 0x6B, b"\x3e", 2 * words)

    rig.run(misread)
    k, missing, jump, _ = rig.holes()
    assert not at
    assert rig.driver.realigned == 2
    assert 2 <= missing.sum() <= 2 * 17
    assert np.abs(np.cumsum(jump) - np.cumsum(missing)).max() <= 1
    assert len(rig.chip.truth().t) - k[-1] <= 17


def test_the_native_search_for_the_end_of_the_scale_finds_what_the_plain_one_does():
    fast, rng = native.load(), random.Random(2)
    ends = (-32768, -32767, 32766, 32767)
    found = set()
    for _ in range(300):
        values = [rng.choice(ends) if rng.random() < 0.02 else rng.randrange(-9, 9) for _ in range(30)]
        at, last = sorted((rng.randrange(31), rng.randrange(31)))
        plain = sampler.saturated_plain(values, at, last)
        assert plain == any(v in (-32768, 32767) for v in values[at:last])
        # A pointer to 16 bits has no sign.
        assert bool(fast.saturated([v & 0xFFFF for v in values], at, last)) == plain
        found.add(plain)
    assert found == {True, False}


def filled(depth, count):
    """An outbox into which `count` frames were put, each with its number as payload."""
    box = Outbox(depth, 7)
    for number in range(count):
        note = box.note()
        note[outbox_module.PAYLOAD] = number & 0xFF
        box.post(5, 1)
    return box


def frames(box):
    """(sequence number, payload) of what the link would still get."""
    decoder, out = hubowire.FrameDecoder(), []
    while (slot := box.oldest()) is not None:
        wire = bytes(slot.raw[1 + box.sent : slot.end])
        out += [(f.seq, f.payload[0]) for f in decoder.feed(wire)]
        box.advance(len(wire))
    return out


@pytest.mark.parametrize("count", [0, 1, 3, 4, 5, 11, 300])
def test_the_queue_drops_the_oldest_and_counts_every_one(count):
    box = filled(4, count)
    assert (box.dropped, box.count, box.high_water) == (max(0, count - 4), min(count, 4), min(count, 4))
    assert frames(box) == [(n, n & 0xFF) for n in range(max(0, count - 4), count)]
    assert (box.count, box.sent, box.high_water) == (0, 0 if count else -1, min(count, 4)), (
        "the high water stays"
    )


def test_a_frame_that_is_half_on_the_wire_is_not_the_one_that_goes():
    box = filled(4, 4)
    first = bytes(box.oldest().raw[1 : box.oldest().end])
    box.advance(3)
    for _ in range(6):
        box.post(5, 1)
    assert box.dropped == 6
    assert bytes(box.oldest().raw[1 : box.oldest().end]) == first
    box.advance(len(first) - 3)
    assert [seq for seq, _ in frames(box)] == [7, 8, 9]
