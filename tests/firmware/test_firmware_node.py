"""The whole node in real MicroPython on the virtual board: chips, faults, times, nothing invented."""

from array import array
from types import SimpleNamespace

import numpy as np
import pytest
from node import Node
from outbox import Outbox

import hubowire
from fakes.fake_port import PORT_TICKS
from hubodo.emulator.board.settings import Clock, SensorBoard
from hubodo.emulator.chips.faults import BrownOut, BusNack, MissedSamples, OdrStep, StuckBus
from hubodo.emulator.chips.imu import Specimen
from hubowire import messages as m
from virtual_runs import PERIOD, matched, of, run

RATES = [
    ("lsm6ds33", 208, 0.0),
    ("lsm6ds33", 208, 0.1),
    ("lsm6ds33", 416, -0.1),
    ("lsm6ds33", 833, 0.07),
    ("lsm6ds33", 1660, -0.04),
    ("mpu6050", 200, 0.03),
    ("lsm6ds33", 104, 0.05),
    ("mpu6500", 1000, -0.02),
]


@pytest.mark.parametrize(("chip", "rate", "odr_error"), RATES)
def test_every_sample_arrives_in_order_and_its_time_is_known(chip, rate, odr_error):
    sent, truth, _ = run(
        5, sensors=SensorBoard(chip, specimen=Specimen(odr_error=odr_error)), config={"rate_hz": rate}
    )
    rows = matched(sent, truth)
    # Between waking and its configuration an MPU runs at its own rate: those samples are not asked for.
    assert np.array_equal(rows[:, 0] - rows[0, 0], np.arange(len(rows)))
    assert np.array_equal(rows[:, 2], np.arange(len(rows)))
    assert truth.t[int(rows[0, 0])] < 0.03 and len(truth.t) - rows[-1, 0] <= 20
    settled = rows[truth.t[rows[:, 0].astype(int)] > 3.5, 1]
    print(f"{chip} {rate} Hz: time error {settled.mean():.0f} +- {settled.std():.0f} us")
    # At 416 Hz the chip is looked at only 26 times a second, and the estimate settles more slowly.
    assert np.abs(settled).max() < (400 if rate == 416 else 200)
    period_us = of(sent, m.ImuBatch)[-1].period_ns / 1000
    assert period_us == pytest.approx(np.median(np.diff(truth.t)) * 1e6, rel=5e-4)
    health = of(sent, m.Health)[-1]
    assert (health.faults, health.samples_missed, health.frames_dropped, health.i2c_errors) == (0, 0, 0, 0)


def test_times_run_on_when_the_ticks_begin_anew():
    start = PERIOD - 2_000_000
    sent, truth, _ = run(4, clock=Clock(ticks_start_us=start))
    rows = matched(sent, truth, start)
    assert np.array_equal(rows[:, 0], np.arange(len(rows)))
    assert np.abs(rows[len(rows) // 2 :, 1]).max() < 200
    assert {batch.t_us < PERIOD // 2 for batch in of(sent, m.ImuBatch)} == {True, False}


FAULTS = [
    ("lsm6ds33", 208, BusNack(t=2.0, count=3)),
    ("lsm6ds33", 208, StuckBus(t=2.0)),
    ("lsm6ds33", 208, MissedSamples(t=2.0, n=5)),
    ("lsm6ds33", 208, BrownOut(t=2.0, affected="chips")),
    ("lsm6ds33", 1660, StuckBus(t=2.0)),
    ("lsm6ds33", 833, BrownOut(t=2.0, affected="chips")),
    ("mpu6050", 200, StuckBus(t=2.0)),
    ("mpu6050", 1000, StuckBus(t=2.0)),
]


@pytest.mark.parametrize(
    ("chip", "rate", "fault"), FAULTS, ids=lambda value: getattr(value, "__class__", value)
)
def test_after_a_fault_samples_go_on_and_what_is_lost_is_flagged(chip, rate, fault):
    sent, truth, _ = run(5, sensors=SensorBoard(chip), config={"rate_hz": rate}, faults=[fault])
    rows = matched(sent, truth)
    k = rows[:, 0]
    assert np.all(np.diff(k) > 0), "no sample twice, none out of order"
    assert truth.t[int(k[-1])] > 4.8, "still sampling at the end"
    gaps = np.flatnonzero(
        (np.diff(k) > 1) | (np.diff(truth.t[k.astype(int)]) > 1.5 * np.median(np.diff(truth.t)))
    )
    flagged = [batch for batch in of(sent, m.ImuBatch) if batch.flags & m.BatchFlag.GAP_BEFORE]
    assert len(flagged) == len(gaps)
    health = of(sent, m.Health)[-1]
    jumps = np.diff(rows[:, 2]) - 1
    assert jumps.sum() == health.samples_missed
    if len(gaps):
        between = np.diff(truth.t[k.astype(int)])[gaps]
        expected = between / np.median(np.diff(truth.t)) - 1
        assert abs(health.samples_missed - expected.sum()) <= 1 + 0.01 * expected.sum()
    assert health.faults == 0
    if isinstance(fault, StuckBus):
        assert health.bus_recoveries >= 1 and health.i2c_errors >= 1
    if isinstance(fault, BusNack):
        assert health.i2c_errors == 3


@pytest.mark.parametrize("chip", ["lsm6ds33", "mpu6050"])
def test_the_fifo_serves_low_rates_when_asked_to(chip):
    sent, truth, stats = run(4, sensors=SensorBoard(chip), config={"rate_hz": 208, "fifo": True})
    rows = matched(sent, truth)
    assert np.array_equal(rows[:, 0] - rows[0, 0], np.arange(len(rows)))
    # One look at the chip in eight samples: the estimate needs longer to find the edge.
    assert np.abs(rows[len(rows) * 3 // 4 :, 1]).max() < 1000
    # Polled, each sample takes more than two; here only the 0.4 s in which the period is measured do.
    assert stats["bus"]["transactions"] < 1.5 * len(rows)


def test_a_chip_that_becomes_faster_is_followed_without_losing_a_sample():
    sent, truth, _ = run(5, faults=[OdrStep(t=2.0, ratio=1.02)])
    rows = matched(sent, truth)
    assert np.array_equal(rows[:, 0], np.arange(len(rows)))
    assert len(truth.t) - len(rows) <= 8


@pytest.mark.parametrize("rate", [208, 416])
def test_a_chip_that_answers_only_later_is_found_and_read_in_whole_batches(rate):
    """Nobody answers when the node starts; the FIFO needs slots that the later search has shaped."""
    sent, truth, _ = run(5, config={"rate_hz": rate}, faults=[BusNack(t=0.0, count=1)])
    assert any(hello.rate_mhz == 0 for hello in of(sent, m.Hello)), "it began without a chip"
    rows = matched(sent, truth)
    assert len(rows) > 3 * rate
    assert np.array_equal(np.diff(rows[:, 0]), np.ones(len(rows) - 1))


def test_another_chip_at_the_address_is_refused_and_named():
    sent, _, _ = run(3, sensors=SensorBoard(specimen=Specimen(who_am_i=0x6A)))
    assert not of(sent, m.ImuBatch)
    assert of(sent, m.Health)[-1].faults == m.Fault.WRONG_WHO_AM_I
    assert (0x6B, 0x6A, 0) in of(sent, m.Hello)[-1].parts


def test_an_unknown_mpu_is_used_and_its_id_told():
    sent, truth, _ = run(3, sensors=SensorBoard("mpu6050", specimen=Specimen(who_am_i=0x34)))
    assert len(matched(sent, truth)) > 500
    assert (0x68, 0x34, 0) in of(sent, m.Hello)[-1].parts


class Mag:
    """A magnetometer that answers with what is told: 0, 1 or an error."""

    rate_hz = 80

    def __init__(self):
        self.answer, self.configured = 1, 0

    def read_into(self, words, at):
        if self.answer is None:
            raise OSError(5)
        words[at : at + 3] = array("h", (7, -8, 9))
        return self.answer

    def configure(self):
        self.configured += 1


def a_node(**parts):
    """As much of a node as its loop looks at, on the ticks of the fake port."""
    node_ = object.__new__(Node)
    known = {"chip": None, "mag": None, "failures": 0, "paused": False, "i2c_errors": 0}
    node_.parts = SimpleNamespace(**{**known, **parts})
    node_.outbox = Outbox(4, 1)
    node_._mag_words, node_._mag_waits = array("h", bytes(8)), 0
    return node_


def test_a_field_is_told_with_its_time_and_asked_for_again_shortly_before_the_next():
    node = a_node(mag=Mag())
    PORT_TICKS.now_us = 123_456
    node._read_mag(1000)
    slot = node.outbox.oldest()
    (frame,) = hubowire.FrameDecoder().feed(bytes(slot.raw[1 + node.outbox.sent : slot.end]))
    assert hubowire.decode(frame.type_id, frame.payload) == m.Mag(123_456, (7, -8, 9))
    assert node._mag_ms == 1000 + 1000 // 80 - 5
    node._mag_waits = 3
    node._read_mag(2000)
    assert node._mag_waits == 0


def test_a_magnetometer_that_has_nothing_new_is_asked_every_5_ms_and_set_up_again_after_a_second():
    node = a_node(mag=Mag())
    node.parts.mag.answer, ms = 0, 0
    for k in range(1, 402):
        node._read_mag(ms)
        assert node._mag_ms == ms + 5 and not node.outbox.count
        ms = node._mag_ms
        assert node.parts.mag.configured == (k > 200), k
    node._read_mag(ms)
    assert node.parts.mag.configured == 2


def test_an_error_of_the_magnetometer_counts_and_one_of_the_bus_leaves_it_alone():
    node = a_node(mag=Mag())
    node.parts.mag.answer = None
    node._read_mag(100)
    assert (node.parts.i2c_errors, node._mag_ms, node.outbox.count) == (1, 105, 0)
    for of_the_bus in ({"failures": 1}, {"paused": True}):
        node = a_node(mag=Mag(), **of_the_bus)
        node._read_mag(100)
        assert (node._mag_ms, node.outbox.count, node.parts.i2c_errors) == (105, 0, 0)


@pytest.mark.parametrize(
    ("look_ms", "due_us", "waiting", "waits", "sleeps_us"),
    [
        (20, None, 0, 20, 0),
        (20, None, 1, 1, 0),
        (20, 8100, 0, 8, 0),
        (20, 1100, 0, 1, 0),
        (20, 1099, 0, None, 999),
        (20, 100, 0, None, 0),
        (20, -500, 0, None, 0),
        (3, 8100, 0, 3, 0),
        (0, None, 0, None, 0),
    ],
)
def test_it_listens_until_a_tenth_of_a_millisecond_before_what_is_due_and_sleeps_the_rest(
    look_ms, due_us, waiting, waits, sleeps_us
):
    node, frames = a_node(), []
    PORT_TICKS.now_us = 50_000_000
    node._duty_ms = 50_000 + look_ms
    node.link = SimpleNamespace(wait=frames.append)
    node.outbox = SimpleNamespace(count=waiting)
    if due_us is not None:
        node.parts.chip, node.sampler = "a chip", SimpleNamespace(due_us=50_000_000 + due_us)
    node._idle(50_000_000)
    assert frames == ([] if waits is None else [waits])
    assert PORT_TICKS.now_us - 50_000_000 == sleeps_us
    node.parts.paused = True
    frames.clear()
    PORT_TICKS.now_us = 50_000_000
    node._idle(50_000_000)
    assert frames == ([1 if waiting else look_ms] if look_ms else []), (
        "no sample is due on a bus that is left alone"
    )


@pytest.mark.parametrize("takes_ms", [0, 40, None])
def test_before_it_ends_a_link_has_a_third_of_a_second_to_take_what_waits(takes_ms):
    node, fed = a_node(), []
    PORT_TICKS.now_us = begin_us = 70_000_000
    node.outbox = SimpleNamespace(count=0 if takes_ms == 0 else 1)

    def send(outbox):
        if takes_ms is not None and PORT_TICKS.now_us >= begin_us + 1000 * takes_ms:
            outbox.count = 0

    def feed():
        assert len(fed) < 999
        fed.append(PORT_TICKS.now_us)

    node.link, node.board = SimpleNamespace(send=send), SimpleNamespace(feed=feed)
    node.farewell()
    took_ms = (PORT_TICKS.now_us - begin_us) / 1000
    assert took_ms == pytest.approx(300 if takes_ms is None else takes_ms, abs=2)
    assert len(fed) == pytest.approx(took_ms, abs=2), "the watchdog is fed meanwhile"
