"""The whole node in real MicroPython on the virtual board: chips, faults, times, no invented samples."""

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
from repetitions import first_and_more
from virtual_runs import PERIOD, match_samples, messages_of, run

RATES = [
    ("lsm6ds33", 208, 0.1),
    ("lsm6ds33", 1660, -0.04),
    ("mpu6050", 200, 0.03),
    *first_and_more(
        ("mpu6500", 1000, -0.02),
        ("lsm6ds33", 208, 0.0),
        ("lsm6ds33", 416, -0.1),
        ("lsm6ds33", 833, 0.07),
        ("lsm6ds33", 104, 0.05),
    ),
]


@pytest.mark.parametrize(("chip", "rate", "odr_error"), RATES)
def test_every_sample_arrives_in_order_with_an_accurate_time(chip, rate, odr_error):
    sent, truth, _ = run(
        5, sensors=SensorBoard(chip, specimen=Specimen(odr_error=odr_error)), config={"rate_hz": rate}
    )
    rows = match_samples(sent, truth)
    # Between power-up and configuration an MPU samples at its default rate: these samples are not read.
    assert np.array_equal(rows[:, 0] - rows[0, 0], np.arange(len(rows)))
    assert np.array_equal(rows[:, 2], np.arange(len(rows)))
    assert truth.t[int(rows[0, 0])] < 0.03 and len(truth.t) - rows[-1, 0] <= 20
    settled = rows[truth.t[rows[:, 0].astype(int)] > 3.5, 1]
    print(f"{chip} {rate} Hz: time error {settled.mean():.0f} +- {settled.std():.0f} us")
    # At 416 Hz the FIFO is polled only 26 times per second, and the time estimate converges more slowly.
    assert np.abs(settled).max() < (400 if rate == 416 else 200)
    period_us = messages_of(sent, m.ImuBatch)[-1].period_ns / 1000
    assert period_us == pytest.approx(np.median(np.diff(truth.t)) * 1e6, rel=5e-4)
    health = messages_of(sent, m.Health)[-1]
    assert (health.faults, health.samples_missed, health.frames_dropped, health.i2c_errors) == (0, 0, 0, 0)


def test_times_continue_when_the_ticks_wrap():
    start = PERIOD - 2_000_000
    sent, truth, _ = run(4, clock=Clock(ticks_start_us=start))
    rows = match_samples(sent, truth, start)
    assert np.array_equal(rows[:, 0], np.arange(len(rows)))
    assert np.abs(rows[len(rows) // 2 :, 1]).max() < 200
    assert {batch.t_us < PERIOD // 2 for batch in messages_of(sent, m.ImuBatch)} == {True, False}


FAULTS = [
    ("lsm6ds33", 208, BusNack(t=2.0, count=3)),
    ("lsm6ds33", 208, MissedSamples(t=2.0, n=5)),
    ("lsm6ds33", 833, BrownOut(t=2.0, affected="chips")),
    ("lsm6ds33", 1660, StuckBus(t=2.0)),
    *first_and_more(
        ("mpu6050", 200, StuckBus(t=2.0)),
        ("lsm6ds33", 208, StuckBus(t=2.0)),
        ("lsm6ds33", 208, BrownOut(t=2.0, affected="chips")),
        ("mpu6050", 1000, StuckBus(t=2.0)),
    ),
]


@pytest.mark.parametrize(
    ("chip", "rate", "fault"), FAULTS, ids=lambda value: getattr(value, "__class__", value)
)
def test_after_a_fault_sampling_continues_and_lost_samples_are_flagged(chip, rate, fault):
    sent, truth, _ = run(5, sensors=SensorBoard(chip), config={"rate_hz": rate}, faults=[fault])
    rows = match_samples(sent, truth)
    k = rows[:, 0]
    assert np.all(np.diff(k) > 0), "no sample is repeated or out of order"
    assert truth.t[int(k[-1])] > 4.8, "the node stopped sampling"
    gaps = np.flatnonzero(
        (np.diff(k) > 1) | (np.diff(truth.t[k.astype(int)]) > 1.5 * np.median(np.diff(truth.t)))
    )
    flagged = [batch for batch in messages_of(sent, m.ImuBatch) if batch.flags & m.BatchFlag.GAP_BEFORE]
    assert len(flagged) == len(gaps)
    health = messages_of(sent, m.Health)[-1]
    jumps = np.diff(rows[:, 2]) - 1
    assert jumps.sum() == health.samples_missed
    if len(gaps):
        gap_s = np.diff(truth.t[k.astype(int)])[gaps]
        expected = gap_s / np.median(np.diff(truth.t)) - 1
        assert abs(health.samples_missed - expected.sum()) <= 1 + 0.01 * expected.sum()
    assert health.faults == 0
    if isinstance(fault, StuckBus):
        assert health.bus_recoveries >= 1 and health.i2c_errors >= 1
    if isinstance(fault, BusNack):
        assert health.i2c_errors == 3


@pytest.mark.parametrize("chip", ["lsm6ds33", "mpu6050"])
def test_the_fifo_can_be_used_at_low_rates(chip):
    sent, truth, stats = run(4, sensors=SensorBoard(chip), config={"rate_hz": 208, "fifo": True})
    rows = match_samples(sent, truth)
    assert np.array_equal(rows[:, 0] - rows[0, 0], np.arange(len(rows)))
    # The FIFO is polled once in eight samples: the time estimate converges more slowly.
    assert np.abs(rows[len(rows) * 3 // 4 :, 1]).max() < 1000
    # Polling takes more than two transactions per sample, but only in the first 0.4 s.
    assert stats["bus"]["transactions"] < 1.5 * len(rows)


def test_a_step_of_the_chip_rate_loses_no_sample():
    sent, truth, _ = run(5, faults=[OdrStep(t=2.0, ratio=1.02)])
    rows = match_samples(sent, truth)
    assert np.array_equal(rows[:, 0], np.arange(len(rows)))
    assert len(truth.t) - len(rows) <= 8


@pytest.mark.parametrize("rate", [208, 416])
def test_a_chip_that_answers_late_is_found_and_read_in_complete_batches(rate):
    """The chip does not answer at the start; slots for the FIFO are shaped by the later search."""
    sent, truth, _ = run(5, config={"rate_hz": rate}, faults=[BusNack(t=0.0, count=1)])
    assert any(hello.rate_mhz == 0 for hello in messages_of(sent, m.Hello)), "the node started without a chip"
    rows = match_samples(sent, truth)
    assert len(rows) > 3 * rate
    assert np.array_equal(np.diff(rows[:, 0]), np.ones(len(rows) - 1))


def test_another_chip_at_the_address_is_refused_and_named():
    sent, _, _ = run(3, sensors=SensorBoard(specimen=Specimen(who_am_i=0x6A)))
    assert not messages_of(sent, m.ImuBatch)
    assert messages_of(sent, m.Health)[-1].faults == m.Fault.WRONG_WHO_AM_I
    assert (0x6B, 0x6A, 0) in messages_of(sent, m.Hello)[-1].parts


@pytest.mark.parametrize(
    ("chip", "who_am_i"), first_and_more(("lsm6ds33", 0x6C), ("mpu6050", 0x47), ("lsm6dso", 0x69))
)
def test_a_chip_with_the_identity_of_another_is_reported_as_silent_for_as_long_as_it_is(chip, who_am_i):
    """The driver of another chip finds no FIFO at its address; each Health has to report that."""
    sent, _, _ = run(4, sensors=SensorBoard(chip, specimen=Specimen(who_am_i=who_am_i)))
    assert not messages_of(sent, m.ImuBatch)
    assert [health.faults for health in messages_of(sent, m.Health)] == 4 * [m.Fault.IMU_SILENT]


def test_an_unknown_mpu_is_used_and_its_id_reported():
    sent, truth, _ = run(3, sensors=SensorBoard("mpu6050", specimen=Specimen(who_am_i=0x34)))
    assert len(match_samples(sent, truth)) > 500
    assert (0x68, 0x34, 0) in messages_of(sent, m.Hello)[-1].parts


class Mag:
    """A magnetometer with a given answer: 0 (no new field), 1 (new) or None (error)."""

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


def create_node(**parts):
    """Return a node with only the parts that the tested methods use, in the ticks of the fake port."""
    fake = object.__new__(Node)
    defaults = {"chip": None, "mag": None, "failures": 0, "paused": False, "i2c_errors": 0}
    fake.parts = SimpleNamespace(**{**defaults, **parts})
    fake.outbox = Outbox(4, 1)
    fake._mag_words, fake._mag_waits = array("h", bytes(8)), 0
    return fake


def test_a_field_is_sent_with_its_time_and_the_next_poll_is_shortly_before_the_next_field():
    node = create_node(mag=Mag())
    PORT_TICKS.now_us = 123_456
    node._read_mag(1000)
    slot = node.outbox.oldest()
    (frame,) = hubowire.FrameDecoder().feed(bytes(slot.raw[1 + node.outbox.sent : slot.end]))
    assert hubowire.decode(frame.type_id, frame.payload) == m.Mag(123_456, (7, -8, 9))
    assert node._mag_ms == 1000 + 1000 // 80 - 5
    node._mag_waits = 3
    node._read_mag(2000)
    assert node._mag_waits == 0


def test_a_magnetometer_without_new_data_is_polled_every_5_ms_and_reconfigured_after_a_second():
    node = create_node(mag=Mag())
    node.parts.mag.answer, ms = 0, 0
    for k in range(1, 402):
        node._read_mag(ms)
        assert node._mag_ms == ms + 5 and not node.outbox.count
        ms = node._mag_ms
        assert node.parts.mag.configured == (k > 200), k
    node._read_mag(ms)
    assert node.parts.mag.configured == 2


def test_magnetometer_errors_are_counted_and_it_is_not_polled_while_the_bus_fails():
    node = create_node(mag=Mag())
    node.parts.mag.answer = None
    node._read_mag(100)
    assert (node.parts.i2c_errors, node._mag_ms, node.outbox.count) == (1, 105, 0)
    for bus_state in ({"failures": 1}, {"paused": True}):
        node = create_node(mag=Mag(), **bus_state)
        node._read_mag(100)
        assert (node._mag_ms, node.outbox.count, node.parts.i2c_errors) == (105, 0, 0)


@pytest.mark.parametrize(
    ("duty_ms", "due_us", "waiting", "listens_ms", "sleeps_us"),
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
def test_the_idle_loop_listens_until_0_1_ms_before_the_next_task_and_sleeps_the_rest(
    duty_ms, due_us, waiting, listens_ms, sleeps_us
):
    node, listened_ms = create_node(), []
    PORT_TICKS.now_us = 50_000_000
    node._duty_ms = 50_000 + duty_ms
    node.link = SimpleNamespace(wait=listened_ms.append)
    node.outbox = SimpleNamespace(count=waiting)
    if due_us is not None:
        node.parts.chip, node.sampler = "a chip", SimpleNamespace(due_us=50_000_000 + due_us)
    node._idle(50_000_000)
    assert listened_ms == ([] if listens_ms is None else [listens_ms])
    assert PORT_TICKS.now_us - 50_000_000 == sleeps_us
    node.parts.paused = True
    listened_ms.clear()
    PORT_TICKS.now_us = 50_000_000
    node._idle(50_000_000)
    assert listened_ms == ([1 if waiting else duty_ms] if duty_ms else []), (
        "no sample is due while the bus is paused"
    )


@pytest.mark.parametrize("takes_ms", [0, 40, None])
def test_before_a_restart_the_link_has_0_3_s_to_send_waiting_frames(takes_ms):
    node, fed_us = create_node(), []
    PORT_TICKS.now_us = start_us = 70_000_000
    node.outbox = SimpleNamespace(count=0 if takes_ms == 0 else 1)

    def send(outbox):
        if takes_ms is not None and PORT_TICKS.now_us >= start_us + 1000 * takes_ms:
            outbox.count = 0

    def feed():
        assert len(fed_us) < 999
        fed_us.append(PORT_TICKS.now_us)

    node.link, node.board = SimpleNamespace(send=send), SimpleNamespace(feed=feed)
    node.farewell()
    took_ms = (PORT_TICKS.now_us - start_us) / 1000
    assert took_ms == pytest.approx(300 if takes_ms is None else takes_ms, abs=2)
    assert len(fed_us) == pytest.approx(took_ms, abs=2), "the watchdog is fed while waiting"
