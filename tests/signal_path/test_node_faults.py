"""Faults injected into the real firmware are reported, sampling continues, and no data is invented."""

import numpy as np
import pytest

from hubodo.emulator.board.settings import BoardSettings, SensorBoard
from hubodo.emulator.chips.faults import (
    BitFlip,
    BrownOut,
    BusNack,
    MissedSamples,
    Stall,
    StuckBus,
    WrongWhoAmI,
)
from hubodo.emulator.chips.imu import Specimen
from hubowire import messages as m
from repetitions import first_and_more
from virtual_runs import count_missing_frames, match_samples, messages_of, run

CTRL1_XL, CTRL2_G, FIFO_CTRL5 = 0x10, 0x11, 0x0A


def holes(sent, truth):
    """Return the index of each sample in the truth, and the samples missing after it in truth and by number.

    Checks that each sample equals the chip's, in order, and that batches flag missing samples.
    """
    matches = match_samples(sent, truth)
    k, number = matches[:, 0].astype(int), np.unwrap(matches[:, 2], period=65536)
    says = np.array(
        [
            i == 0 and bool(b.flags & m.BatchFlag.GAP_BEFORE)
            for b in messages_of(sent, m.ImuBatch)
            for i in range(len(b.samples))
        ]
    )
    assert np.all(np.diff(k) > 0), "no sample twice, none out of order"
    missing, jump = np.diff(k) - 1, np.diff(number) - 1
    assert np.all(jump >= 0)
    assert np.all(says[1:][missing > 0]), "each hole is announced"
    assert np.all(says[1:][jump > 0]), "each jump is announced"
    return k, missing, jump


def polled_below_250(rate):
    """Return settings for both ways of sampling: the chip's FIFO is used from 250 Hz."""
    return {"rate_hz": rate, "fifo": rate > 250}


def last_health(sent):
    return messages_of(sent, m.Health)[-1]


@pytest.mark.parametrize("rate", [208, 1660])
def test_samples_lost_by_a_stalled_processor_are_numbered_and_counted(rate):
    """Stalls at random times, one longer than the FIFO (0.41 s): index, count and truth agree."""
    seed = 11
    rng = np.random.default_rng(seed)
    stalls = [Stall(t=1.2 + 0.25 * i + 0.2 * rng.random(), seconds=0.03 * rng.random()) for i in range(10)]
    stalls += [Stall(t=4.0, seconds=0.7), Stall(t=5.0, seconds=0.12)]
    sent, truth, stats = run(
        6,
        sensors=SensorBoard(specimen=Specimen(odr_error=0.02)),
        config=polled_below_250(rate),
        faults=stalls,
    )
    assert stats["counts"]["stalls"] == len(stalls), f"seed {seed}"
    k, missing, jump = holes(sent, truth)
    health = last_health(sent)
    print(
        f"seed {seed}: {rate} Hz: {missing.sum()} lost, {jump.sum()} by number, "
        f"{health.samples_missed} reported"
    )
    assert missing.sum() > 100
    assert jump.sum() == health.samples_missed
    assert np.abs(np.cumsum(jump) - np.cumsum(missing)).max() <= 1 + 0.002 * missing.sum()
    assert truth.t[k[-1]] > 5.9
    assert health.fifo_overruns == (1 if rate == 1660 else 0)
    assert any(b.flags & m.BatchFlag.FIFO_OVERRUN for b in messages_of(sent, m.ImuBatch)) == (rate == 1660)
    assert health.faults == 0
    assert 700_000 <= max(h.worst_loop_us for h in messages_of(sent, m.Health)) < 720_000


def test_a_slow_host_loses_the_oldest_frames_and_no_sample_is_missed():
    """115200 baud for 1660 Hz: half of the frames are dropped, and each is counted."""
    config = {"rate_hz": 1660, "link": "uart", "baud": 115200}
    sent, truth, _ = run(4, board=BoardSettings(uart_link=0), config=config)
    matches = match_samples(sent, truth)
    missing, jump = np.diff(matches[:, 0]) - 1, np.diff(matches[:, 2]) - 1
    at = max(i for i, (_, message) in enumerate(sent) if isinstance(message, m.Health))
    health = sent[at][1]
    seqs = [f.seq for f, message in sent if isinstance(message, m.ImuBatch)]
    lost = seqs[-1] - seqs[0] + 1 - len(seqs)
    assert lost > 20
    assert 0 <= count_missing_frames(sent[: at + 1]) - health.frames_dropped <= 24, (
        "those that went while it waited"
    )
    assert health.queue_high_water == 24
    assert (health.samples_missed, health.fifo_overruns, health.faults) == (0, 0, 0)
    assert np.array_equal(missing, jump), "what did not come is numbered exactly"
    assert missing.sum() == 19 * lost, "at this rate a frame is full"
    assert truth.t[int(matches[-1, 0])] > 3.5


@pytest.mark.parametrize(
    ("chip", "rate", "count"),
    [
        ("lsm6ds33", 208, 60),
        ("mpu6050", 200, 40),
        *first_and_more(("lsm6ds33", 1660, 40), ("lsm6ds33", 208, 1), ("lsm6ds33", 208, 40)),
    ],
)
def test_a_burst_of_refused_transfers_is_counted_and_survived(chip, rate, count):
    sent, truth, _ = run(
        4, sensors=SensorBoard(chip), config=polled_below_250(rate), faults=[BusNack(t=2.0, count=count)]
    )
    k, missing, jump = holes(sent, truth)
    health = last_health(sent)
    assert health.i2c_errors == count
    assert (health.bus_recoveries > 0) == (count > 50), "freed only once samples stay away"
    assert np.abs(jump.sum() - missing.sum()) <= 1
    assert jump.sum() == health.samples_missed
    assert health.faults == 0
    assert truth.t[k[-1]] > 3.9


def test_a_chip_that_never_answers_again_is_reported_as_silent():
    sent, truth, _ = run(4, faults=[BusNack(t=2.0, count=1_000_000)])
    k, _, _ = holes(sent, truth)
    assert 1.9 < truth.t[k[-1]] <= 2.0
    assert last_health(sent).faults & m.Fault.IMU_SILENT
    assert last_health(sent).i2c_errors > 10


@pytest.mark.parametrize(("chip", "rate"), first_and_more(("mpu6500", 250), ("lsm6ds33", 416)))
def test_a_held_bus_is_freed_with_nine_clocks(chip, rate):
    sent, truth, stats = run(
        4, sensors=SensorBoard(chip), config=polled_below_250(rate), faults=[StuckBus(t=1.5), StuckBus(t=2.5)]
    )
    k, missing, jump = holes(sent, truth)
    assert stats["bus"]["freed"] == 2
    health = last_health(sent)
    assert health.bus_recoveries == 2 and health.i2c_errors >= 2 and health.faults == 0
    assert jump.sum() == health.samples_missed == pytest.approx(missing.sum(), abs=2)
    assert truth.t[k[-1]] > 3.9


def test_a_brown_out_of_the_board_is_a_restart_with_a_new_boot_id():
    sent, truth, stats = run(4, faults=[BrownOut(t=2.0)])
    assert [why for _, why in stats["resets"]] == ["brown-out"]
    hellos = messages_of(sent, m.Hello)
    assert len({hello.boot_id for hello in hellos}) == 2
    matches = match_samples(sent, truth)
    assert np.all(np.diff(matches[:, 0]) > 0)
    restart = int(np.flatnonzero(np.diff(matches[:, 2]) < 0)[0])
    assert matches[restart + 1, 2] == 0, "numbers restart with the boot id"
    assert truth.t[int(matches[-1, 0])] > 3.9


@pytest.mark.parametrize("rate", first_and_more(833, 208))
def test_a_brown_out_of_the_chip_alone_is_a_counted_gap(rate):
    sent, truth, _ = run(4, config=polled_below_250(rate), faults=[BrownOut(t=2.0, affected="chips")])
    k, _, jump = holes(sent, truth)
    hole = np.diff(truth.t[k]) * rate - 1
    assert jump.sum() == last_health(sent).samples_missed == pytest.approx(hole[hole > 0.5].sum(), abs=2)
    assert truth.t[k[-1]] > 3.9


@pytest.mark.parametrize(
    ("rate", "n"), [(208, 400), *first_and_more((1660, 2), (208, 1), (208, 104), (1660, 830))]
)
def test_samples_missed_by_the_chip_are_a_gap(rate, n):
    sent, truth, _ = run(5, config=polled_below_250(rate), faults=[MissedSamples(t=2.0, n=n)])
    k, missing, jump = holes(sent, truth)
    missed = last_health(sent).samples_missed
    given_up = missing.sum()
    assert jump.sum() == missed == pytest.approx(n + given_up, abs=1)
    assert given_up <= (0 if rate == 208 else 40)
    silent = any(h.faults & m.Fault.IMU_SILENT for h in messages_of(sent, m.Health))
    assert silent == (n >= 104), "the report 0.2 s later sees a silence of half a second, not one of 10 ms"
    assert last_health(sent).faults == 0
    assert truth.t[k[-1]] > 4.9


FLIPS = [
    ("gyro range", 208, BitFlip(t=2.0, register=CTRL2_G, bit=3)),
    ("accelerometer range", 1660, BitFlip(t=2.0, register=CTRL1_XL, bit=2)),
    ("rate", 208, BitFlip(t=2.0, register=CTRL1_XL, bit=5)),
    ("gyro off", 208, BitFlip(t=2.0, register=CTRL2_G, bit=6)),
    ("gyro off", 208, BitFlip(t=2.3324, register=CTRL2_G, bit=6)),
    ("FIFO off", 416, BitFlip(t=2.0, register=FIFO_CTRL5, bit=2)),
]


@pytest.mark.parametrize(("what", "rate", "flip"), FLIPS, ids=[row[0] for row in FLIPS])
def test_a_flipped_chip_setting_is_detected_within_a_second_and_restored(what, rate, flip):
    sent, truth, _ = run(5, config=polled_below_250(rate), faults=[flip])
    matches = match_samples(sent, truth)
    k = matches[:, 0].astype(int)
    assert truth.t[k[-1]] > 4.9
    true_lsb = np.array([0.07 * np.pi / 180] * 3 + [0.488e-3 * 9.80665] * 3)
    wrong = truth.t[(np.abs(truth.lsb / true_lsb - 1) > 1e-6).any(axis=1)]
    found_by = flip.t + 1.2
    assert not len(wrong) or flip.t - 0.1 < wrong[-1] < found_by
    flagged = [b for b in messages_of(sent, m.ImuBatch) if b.flags & m.BatchFlag.GAP_BEFORE]
    health = last_health(sent)
    assert flagged and health.i2c_errors + health.samples_missed > 0
    late = truth.t[k] > found_by
    assert np.median(np.diff(truth.t[k][late])) == pytest.approx(1 / rate, rel=0.01)
    assert np.all(np.diff(matches[late, 2]) == 1)


def test_another_chip_in_its_place_is_refused_while_running():
    sent, truth, _ = run(5, faults=[WrongWhoAmI(t=2.0, value=0x6A)])
    k, _, _ = holes(sent, truth)
    assert 1.9 < truth.t[k[-1]] < 3.2, "its id is looked at every second"
    assert last_health(sent).faults == m.Fault.WRONG_WHO_AM_I
    assert (0x6B, 0x6A, 0) in messages_of(sent, m.Hello)[-1].parts
