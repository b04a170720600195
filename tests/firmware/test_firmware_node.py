"""The whole node in real MicroPython on the virtual board: chips, faults, times, nothing invented."""

import numpy as np
import pytest

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
    found = matched(sent, truth)
    # Between waking and its configuration an MPU runs at its own rate: those samples are not asked for.
    assert np.array_equal(found[:, 0] - found[0, 0], np.arange(len(found)))
    assert np.array_equal(found[:, 2], np.arange(len(found)))
    assert truth.t[int(found[0, 0])] < 0.03 and len(truth.t) - found[-1, 0] <= 20
    settled = found[truth.t[found[:, 0].astype(int)] > 3.5, 1]
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
    found = matched(sent, truth, start)
    assert np.array_equal(found[:, 0], np.arange(len(found)))
    assert np.abs(found[len(found) // 2 :, 1]).max() < 200
    assert {batch.t_us < PERIOD // 2 for batch in of(sent, m.ImuBatch)} == {True, False}


FAULTS = [
    ("lsm6ds33", 208, BusNack(t=2.0, count=3)),
    ("lsm6ds33", 208, StuckBus(t=2.0)),
    ("lsm6ds33", 208, MissedSamples(t=2.0, n=5)),
    ("lsm6ds33", 208, BrownOut(t=2.0, of="chips")),
    ("lsm6ds33", 1660, StuckBus(t=2.0)),
    ("lsm6ds33", 833, BrownOut(t=2.0, of="chips")),
    ("mpu6050", 200, StuckBus(t=2.0)),
    ("mpu6050", 1000, StuckBus(t=2.0)),
]


@pytest.mark.parametrize(
    ("chip", "rate", "fault"), FAULTS, ids=lambda value: getattr(value, "__class__", value)
)
def test_after_a_fault_samples_go_on_and_what_is_lost_is_flagged(chip, rate, fault):
    sent, truth, _ = run(5, sensors=SensorBoard(chip), config={"rate_hz": rate}, faults=[fault])
    found = matched(sent, truth)
    k = found[:, 0]
    assert np.all(np.diff(k) > 0), "no sample twice, none out of order"
    assert truth.t[int(k[-1])] > 4.8, "still sampling at the end"
    gaps = np.flatnonzero(
        (np.diff(k) > 1) | (np.diff(truth.t[k.astype(int)]) > 1.5 * np.median(np.diff(truth.t)))
    )
    flagged = [batch for batch in of(sent, m.ImuBatch) if batch.flags & m.BatchFlag.GAP_BEFORE]
    assert len(flagged) == len(gaps)
    health = of(sent, m.Health)[-1]
    jumps = np.diff(found[:, 2]) - 1
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
    found = matched(sent, truth)
    assert np.array_equal(found[:, 0] - found[0, 0], np.arange(len(found)))
    # One look at the chip in eight samples: the estimate needs longer to find the edge.
    assert np.abs(found[len(found) * 3 // 4 :, 1]).max() < 1000
    # Polled, each sample takes more than two; here only the 0.4 s in which the period is measured do.
    assert stats["bus"]["transactions"] < 1.5 * len(found)


def test_a_chip_that_becomes_faster_is_followed_without_losing_a_sample():
    sent, truth, _ = run(5, faults=[OdrStep(t=2.0, ratio=1.02)])
    found = matched(sent, truth)
    assert np.array_equal(found[:, 0], np.arange(len(found)))
    assert len(truth.t) - len(found) <= 8


@pytest.mark.parametrize("rate", [208, 416])
def test_a_chip_that_answers_only_later_is_found_and_read_in_whole_batches(rate):
    """Nobody answers when the node starts; the FIFO needs slots that the later search has shaped."""
    sent, truth, _ = run(5, config={"rate_hz": rate}, faults=[BusNack(t=0.0, count=1)])
    assert any(hello.rate_mhz == 0 for hello in of(sent, m.Hello)), "it began without a chip"
    found = matched(sent, truth)
    assert len(found) > 3 * rate
    assert np.array_equal(np.diff(found[:, 0]), np.ones(len(found) - 1))


def test_another_chip_at_the_address_is_refused_and_named():
    sent, _, _ = run(3, sensors=SensorBoard(specimen=Specimen(who_am_i=0x6A)))
    assert not of(sent, m.ImuBatch)
    assert of(sent, m.Health)[-1].faults == m.Fault.WRONG_WHO_AM_I
    assert (0x6B, 0x6A, 0) in of(sent, m.Hello)[-1].parts


def test_an_unknown_mpu_is_used_and_its_id_told():
    sent, truth, _ = run(3, sensors=SensorBoard("mpu6050", specimen=Specimen(who_am_i=0x34)))
    assert len(matched(sent, truth)) > 500
    assert (0x68, 0x34, 0) in of(sent, m.Hello)[-1].parts
