"""The emulated LSM6DS33 against its data sheet (DocID026899) and AN4650."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.emulator.chips.faults import BitFlip, BrownOut, BusNack, MissedSamples, OdrStep, WrongWhoAmI
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.lsm6ds33 import Lsm6ds33
from hubodo.emulator.chips.registers import ChipAccessError, NotAcknowledged
from hubodo.emulator.chips.sampling import quantise
from hubodo.emulator.motion import RecordedMotion, StillMotion

BYTE = 9 / 400e3


def ramp() -> RecordedMotion:
    t = np.arange(0, 100, 0.01)
    return RecordedMotion(
        t,
        np.stack([np.sin(t), np.cos(t), 0.2 * t], 1),
        np.stack([9 + 0 * t, 0.5 * t, -0.3 * t], 1),
        25 + 0.1 * t,
    )


def write(chip: Lsm6ds33, t: float, register: int, *values: int) -> None:
    chip.write(t, bytes([register, *values]))


def read(chip: Lsm6ds33, t: float, register: int, n: int = 1) -> bytes:
    chip.write(t, bytes([register]))
    return chip.read(t, n, BYTE)


def running(
    motion: object = None, part: Specimen | None = None, odr: int = 6, fifo: bool = False
) -> Lsm6ds33:
    chip = Lsm6ds33(motion or ramp(), part or Specimen(strict=True))  # type: ignore[arg-type]
    if fifo:
        write(chip, 1.0, 0x08, 0x09)
        write(chip, 1.0, 0x0A, odr << 3 | 6)
    write(chip, 1.0, 0x12, 0x44)
    write(chip, 1.0, 0x10, odr << 4 | 0x04, odr << 4 | 0x0C)
    return chip


def rows(data: bytes) -> np.ndarray:
    return np.frombuffer(data, "<i2").reshape(-1, 6)


def test_power_on_registers_are_those_of_the_data_sheet() -> None:
    chip = Lsm6ds33(StillMotion(), Specimen(strict=True))
    assert {r: read(chip, 0.1, r)[0] for r in (0x0F, 0x10, 0x11, 0x12, 0x18, 0x19, 0x1E, 0x06, 0x0A)} == {
        0x0F: 0x69, 0x10: 0, 0x11: 0, 0x12: 0x04, 0x18: 0x38, 0x19: 0x38, 0x1E: 0, 0x06: 0, 0x0A: 0,
    }  # fmt: skip
    assert read(chip, 0.1, 0x3A, 2) == bytes([0, 0x10])


def test_unknown_registers_raise_when_strict_and_answer_zero_when_not() -> None:
    with pytest.raises(ChipAccessError, match="0x2F"):
        read(Lsm6ds33(StillMotion(), Specimen(strict=True)), 0.0, 0x2F)
    with pytest.raises(ChipAccessError, match="WHO_AM_I"):
        write(Lsm6ds33(StillMotion(), Specimen(strict=True)), 0.0, 0x0F, 1)
    chip = Lsm6ds33(StillMotion())
    assert read(chip, 0.0, 0x2F) == b"\0"
    write(chip, 0.0, 0x0F, 1)
    assert read(chip, 0.0, 0x0F) == b"\x69"
    assert chip.anomalies == {"read 0x2F": 1, "write 0x0F": 1}


@pytest.mark.parametrize("identity", [0x69, 0x6A, 0x6C])
def test_who_am_i_can_be_that_of_another_part(identity: int) -> None:
    assert read(Lsm6ds33(StillMotion(), Specimen(who_am_i=identity)), 0.0, 0x0F)[0] == identity


@pytest.mark.parametrize(("code", "g_per_lsb"), [(0, 0.061e-3), (1, 0.488e-3), (2, 0.122e-3), (3, 0.244e-3)])
def test_accelerometer_range_codes_are_out_of_order(code: int, g_per_lsb: float) -> None:
    chip = Lsm6ds33(StillMotion(), Specimen(strict=True))
    write(chip, 0.0, 0x10, 0x60 | code << 2)
    assert int.from_bytes(read(chip, 1.0, 0x2C, 2), "little", signed=True) == round(1 / g_per_lsb)


@pytest.mark.parametrize(
    ("code", "dps_per_lsb"),
    [(0x00, 8.75e-3), (0x04, 17.5e-3), (0x08, 35e-3), (0x0C, 70e-3), (0x02, 4.375e-3)],
)
def test_gyro_scale_is_per_lsb_and_not_range_over_32768(code: int, dps_per_lsb: float) -> None:
    chip = Lsm6ds33(StillMotion(rate=(0, 0, math.radians(100))), Specimen(strict=True))
    write(chip, 0.0, 0x11, 0x60 | code)
    assert int.from_bytes(read(chip, 1.0, 0x26, 2), "little", signed=True) == round(100 / dps_per_lsb)


def test_temperature_has_sixteen_lsb_per_degree_about_25() -> None:
    chip = running(StillMotion(degrees=35.0))
    assert int.from_bytes(read(chip, 2.0, 0x20, 2), "little", signed=True) == 160


def test_software_reset_brings_back_power_on_values_and_clears_itself() -> None:
    chip = running()
    write(chip, 2.0, 0x12, 0x01)
    assert read(chip, 2.1, 0x10, 3) == bytes([0, 0, 0x04])
    assert read(chip, 3.0, 0x1E) == b"\0"


def test_boot_bit_clears_itself() -> None:
    chip = running()
    write(chip, 2.0, 0x12, 0xC4)
    assert read(chip, 2.0, 0x12)[0] == 0x44


def test_data_ready_rises_with_a_sample_and_falls_when_its_data_are_read() -> None:
    chip = running(odr=5)
    first = 1.0 + 1 / 208
    assert read(chip, first - 1e-6, 0x1E)[0] & 3 == 0
    assert read(chip, first + 1e-6, 0x1E)[0] == 0x07
    read(chip, first + 1e-4, 0x22, 6)
    assert read(chip, first + 4e-4, 0x1E)[0] & 3 == 1
    read(chip, first + 5e-4, 0x28, 6)
    assert read(chip, first + 9e-4, 0x1E)[0] & 3 == 0
    assert read(chip, first + 1 / 208 + 1e-6, 0x1E)[0] & 3 == 3


@given(error=st.floats(-0.1, 0.1), k=st.integers(0, 1500))
def test_sample_k_exists_after_k_plus_one_of_the_parts_own_periods(error: float, k: int) -> None:
    chip = running(part=Specimen(odr_error=error))
    due = 1.0 + (k + 1) / (416 * (1 + error))
    read(chip, due + 1e-7, 0x1E)
    truth = chip.truth()
    assert len(truth.t) == k + 1
    assert truth.t[k] == pytest.approx(due, abs=1e-9)


def test_samples_are_the_motion_at_their_own_time_in_whole_lsb() -> None:
    motion = ramp()
    chip = running(motion, Specimen(odr_error=-0.04))
    read(chip, 3.0, 0x1E)
    truth = chip.truth()
    want = np.concatenate([motion.angular_rate(truth.t), motion.specific_force(truth.t)], 1) / truth.lsb
    assert np.abs(truth.raw - want).max() <= 0.5
    assert np.array_equal(truth.raw, np.rint(want).astype(np.int16))


def test_the_sample_rate_follows_the_temperature() -> None:
    chip = running(StillMotion(degrees=45.0), Specimen(odr_per_degree=-1e-3))
    read(chip, 3.0, 0x1E)
    assert np.diff(chip.truth().t) == pytest.approx(1 / (416 * 0.98), rel=1e-9)


def test_quantisation_rounds_to_nearest_and_saturates() -> None:
    assert quantise(np.array([0.49, 0.51, -0.51, 1e9, -1e9]), 1.0).tolist() == [0, 1, -1, 32767, -32768]


def test_the_fifo_returns_every_sample_in_complete_patterns() -> None:
    chip = running(fifo=True)
    status = read(chip, 2.0, 0x3A, 4)
    n = (status[0] | (status[1] & 0x0F) << 8) // 6
    got = rows(read(chip, 2.0, 0x3E, 12 * n))
    assert n == 416 and status[2:] == b"\0\0"
    assert np.array_equal(got, chip.truth().raw[:n])


def test_the_fifo_can_be_read_byte_by_byte() -> None:
    chip, other = running(fifo=True), running(fifo=True)
    singly = b"".join(read(chip, 1.5, 0x3E, 1) + read(chip, 1.5, 0x3F, 1) for _ in range(12))
    assert singly == read(other, 1.5, 0x3E, 24)


def test_a_fifo_overrun_drops_the_oldest_words_and_reports_the_pattern_position() -> None:
    chip = running(fifo=True)
    status = read(chip, 4.0, 0x3A, 4)
    assert status[1] & 0x40 and status[1] & 0x20
    dropped = chip.fifo_dropped
    pattern = status[2] | (status[3] & 3) << 8
    assert dropped == 6 * len(chip.truth().t) - 4096
    assert pattern == dropped % 6 == 4096 * 5 % 6
    read(chip, 4.0, 0x3E, 2 * (6 - pattern))
    n = (4096 - (6 - pattern)) // 6
    got = rows(read(chip, 4.0, 0x3E, 12 * n))
    first = (dropped + 6 - pattern) // 6
    assert np.array_equal(got, chip.truth().raw[first : first + n])
    assert not read(chip, 4.0, 0x3B)[0] & 0x40


def test_fifo_mode_keeps_the_oldest_and_stops_when_full() -> None:
    chip = Lsm6ds33(ramp(), Specimen(strict=True))
    write(chip, 1.0, 0x08, 0x09)
    write(chip, 1.0, 0x0A, 6 << 3 | 1)
    write(chip, 1.0, 0x10, 0x64, 0x6C)
    got = rows(read(chip, 9.0, 0x3E, 12 * 682))
    assert np.array_equal(got, chip.truth().raw[:682])
    assert read(chip, 9.0, 0x3E, 12) == bytes(12)


def test_watermark_counts_words() -> None:
    chip = Lsm6ds33(ramp(), Specimen(strict=True))
    write(chip, 1.0, 0x06, 60, 0)
    write(chip, 1.0, 0x08, 0x09)
    write(chip, 1.0, 0x0A, 6 << 3 | 6)
    write(chip, 1.0, 0x10, 0x64, 0x6C)
    assert not read(chip, 1.0 + 9.5 / 416, 0x3B)[0] & 0x80
    assert read(chip, 1.0 + 10.5 / 416, 0x3B)[0] & 0x80


def test_bypass_empties_the_fifo() -> None:
    chip = running(fifo=True)
    write(chip, 2.0, 0x0A, 0)
    assert read(chip, 2.0, 0x3A, 2) == bytes([0, 0x10])


def test_decimation_lengthens_the_pattern() -> None:
    chip = Lsm6ds33(ramp(), Specimen(strict=True))
    write(chip, 1.0, 0x08, 0x0A)  # gyro every tick, accelerometer every second one
    write(chip, 1.0, 0x0A, 6 << 3 | 6)
    write(chip, 1.0, 0x10, 0x64, 0x6C)
    read(chip, 1.0 + 4.5 / 416, 0x3A)
    words = np.frombuffer(read(chip, 1.0 + 4.5 / 416, 0x3E, 2 * 18), "<i2")
    raw = chip.truth().raw
    want = np.concatenate([raw[0], raw[1, :3], raw[2], raw[3, :3]])
    assert np.array_equal(words, want)
    assert read(chip, 1.0 + 4.5 / 416, 0x3C)[0] == 0


def test_without_auto_increment_a_burst_stays_on_its_register() -> None:
    chip = Lsm6ds33(StillMotion(), Specimen(strict=True))
    write(chip, 0.0, 0x12, 0x00)
    assert read(chip, 0.0, 0x0F, 3) == b"\x69\x69\x69"


def test_a_burst_across_a_new_sample_mixes_words_and_with_bdu_never_their_bytes() -> None:
    chip = running(odr=5)
    due = 1.0 + 2 / 208
    read(chip, due - 3e-3, 0x22, 12)
    got = rows(read(chip, due - 2.5 * BYTE, 0x22, 12))[0]
    old, new = chip.truth().raw[:2]
    assert np.array_equal(got[:2], old[:2])
    assert np.array_equal(got[2:], new[2:])
    assert read(chip, due + 1e-3, 0x1E)[0] & 3 == 0


def test_missed_samples_leave_a_gap_of_whole_periods() -> None:
    chip = running(part=Specimen(faults=(MissedSamples(2.0, 5),)))
    read(chip, 3.0, 0x1E)
    truth = chip.truth()
    steps = np.rint(np.diff(truth.t) * 416).astype(int)
    assert sorted(set(steps.tolist())) == [1, 6]
    assert len(truth.missed_t) == 5 and np.all((truth.missed_t >= 2.0) & (truth.missed_t < 2.0 + 6 / 416))


def test_an_odr_step_changes_the_rate_from_then_on() -> None:
    chip = running(part=Specimen(faults=(OdrStep(2.0, 1.02),)))
    read(chip, 3.0, 0x1E)
    t = chip.truth().t
    before, after = np.diff(t[t < 2.0]), np.diff(t[t > 2.0 + 1 / 416])
    assert before == pytest.approx(1 / 416, rel=1e-9)
    assert after == pytest.approx(1 / (416 * 1.02), rel=1e-9)


def test_nack_fault_refuses_so_many_addresses() -> None:
    chip = Lsm6ds33(StillMotion(), Specimen(faults=(BusNack(1.0, 2),)))
    chip.acknowledge(0.5)
    for _ in range(2):
        with pytest.raises(NotAcknowledged):
            chip.acknowledge(1.5)
    chip.acknowledge(1.5)


def test_bit_flips_change_register_values() -> None:
    part = Specimen(faults=(WrongWhoAmI(1.0, 0x42), BitFlip(2.0, 0x11, 2), BrownOut(3.0, affected="chips")))
    chip = running(part=part)
    chip.acknowledge(1.5)
    assert read(chip, 1.5, 0x0F)[0] == 0x42
    chip.acknowledge(2.5)
    assert read(chip, 2.5, 0x11)[0] == 0x68
    chip.acknowledge(3.5)
    assert read(chip, 3.5, 0x10, 2) == b"\0\0"
    assert read(chip, 3.6, 0x1E) == b"\0"


def test_disturbance_is_repeatable_by_seed() -> None:
    def noisy(t, gyro, accel, rng):  # type: ignore[no-untyped-def]
        return gyro + rng.normal(0, 0.01, gyro.shape), accel

    def readings(seed: int) -> np.ndarray:
        chip = running(StillMotion(), Specimen(disturbance=noisy, seed=seed))
        read(chip, 3.0, 0x1E)
        return chip.quantised_samples()

    assert np.array_equal(readings(1), readings(1))
    assert not np.array_equal(readings(1), readings(2))
    assert readings(1)[:, :3].std() == pytest.approx(0.01 / math.radians(0.07), rel=0.1)


def test_odr_error_beyond_ten_percent_is_refused() -> None:
    with pytest.raises(ValueError, match="odr_error"):
        Specimen(odr_error=0.2)
