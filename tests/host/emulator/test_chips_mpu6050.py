"""The emulated MPU-6050 and MPU-6500 against RM-MPU-6000A."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.mpu6050 import Mpu6050, Mpu6500
from hubodo.emulator.motion import StillMotion

STRICT = Specimen(strict=True)


def write(chip: Mpu6050, t: float, register: int, *values: int) -> None:
    chip.write(t, bytes([register, *values]))


def read(chip: Mpu6050, t: float, register: int, n: int = 1) -> bytes:
    chip.write(t, bytes([register]))
    return chip.read(t, n, 9 / 400e3)


def awake(chip: Mpu6050, divider: int = 4) -> Mpu6050:
    write(chip, 1.0, 0x1A, 0x02)
    write(chip, 1.0, 0x19, divider)
    write(chip, 1.0, 0x6B, 0x01)
    return chip


def test_it_sleeps_at_reset_and_makes_no_samples() -> None:
    chip = Mpu6050(StillMotion(), STRICT)
    assert read(chip, 1.0, 0x6B)[0] == 0x40
    assert read(chip, 5.0, 0x3B, 14) == bytes(14)
    assert len(chip.truth().t) == 0


@pytest.mark.parametrize(
    ("chip", "identity"), [(Mpu6050(StillMotion()), 0x68), (Mpu6500(StillMotion()), 0x70)]
)
def test_a_chip_reports_its_identity(chip: Mpu6050, identity: int) -> None:
    assert read(chip, 0.0, 0x75)[0] == identity


def test_the_identity_of_clones_can_be_set() -> None:
    assert read(Mpu6050(StillMotion(), Specimen(who_am_i=0x98)), 0.0, 0x75)[0] == 0x98


def test_output_is_big_endian_accel_temperature_gyro() -> None:
    chip = awake(Mpu6050(StillMotion(rate=(math.radians(10), 0, -math.radians(20))), STRICT))
    words = np.frombuffer(read(chip, 2.0, 0x3B, 14), ">i2")
    assert words.tolist() == [0, 0, 16384, round((25 - 36.53) * 340), 1310, 0, -2620]


@pytest.mark.parametrize(("kind", "raw"), [(Mpu6050, (40 - 36.53) * 340), (Mpu6500, (40 - 21) * 333.87)])
def test_temperature_formula_is_the_variants(kind: type[Mpu6050], raw: float) -> None:
    chip = awake(kind(StillMotion(degrees=40.0), STRICT))
    assert int.from_bytes(read(chip, 2.0, 0x41, 2), "big", signed=True) == round(raw)


def test_rate_is_the_divided_base_rate_of_the_filter() -> None:
    chip = awake(Mpu6050(StillMotion(), STRICT), divider=4)
    read(chip, 2.0001, 0x3A)
    assert len(chip.truth().t) == 200
    write(chip, 3.0, 0x1A, 0x00)
    assert chip.sample_hz == 1600


def test_interrupt_status_is_cleared_by_reading_it() -> None:
    chip = awake(Mpu6050(StillMotion(), STRICT))
    assert read(chip, 1.0052, 0x3A)[0] == 0x01
    assert read(chip, 1.0053, 0x3A)[0] == 0x00
    assert read(chip, 1.0102, 0x3A)[0] == 0x01


def fifo(chip: Mpu6050) -> Mpu6050:
    write(chip, 1.0, 0x23, 0x78)
    write(chip, 1.0, 0x6A, 0x44)
    return awake(chip, divider=1)


def test_fifo_holds_accel_then_gyro_and_its_low_count_byte_is_latched() -> None:
    chip = fifo(Mpu6050(StillMotion(rate=(0.1, 0.2, 0.3)), STRICT))
    t = 1.0 + 22.5 / 500
    high = read(chip, t, 0x72)[0]
    later = read(chip, t + 0.1, 0x73)[0]
    assert high << 8 | later == 22 * 12
    data = np.frombuffer(read(chip, t, 0x74, 12 * 22), ">i2").reshape(-1, 6)
    assert np.array_equal(data[:, [3, 4, 5, 0, 1, 2]], chip.truth().raw[:22])


def test_full_fifo_drops_the_oldest_bytes_and_flags_overflow() -> None:
    chip = fifo(Mpu6050(StillMotion(), STRICT))
    assert read(chip, 2.0, 0x3A)[0] & 0x10
    assert read(chip, 2.0, 0x72, 2) == bytes([4, 0])
    assert chip.fifo_dropped == pytest.approx((500 * 12 - 1024) / 2, abs=6)
    write(chip, 2.0, 0x6A, 0x44)
    assert read(chip, 2.0, 0x72, 2) == bytes(2)


def test_device_reset_puts_it_to_sleep_again() -> None:
    chip = awake(Mpu6050(StillMotion(), STRICT))
    write(chip, 2.0, 0x6B, 0x80)
    assert read(chip, 2.0, 0x6B)[0] == 0x40
    assert read(chip, 2.0, 0x19)[0] == 0
