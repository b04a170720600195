"""The emulated LIS3MDL against DocID024204."""

from __future__ import annotations

import numpy as np
import pytest

from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.lis3mdl import Lis3mdl
from hubodo.emulator.motion import StillMotion

FIELD = StillMotion(field_tesla=(20e-6, -10e-6, 40e-6), degrees=31.0)


def write(chip: Lis3mdl, t: float, register: int, value: int) -> None:
    chip.write(t, bytes([register, value]))


def read(chip: Lis3mdl, t: float, sub_address: int, n: int = 1) -> bytes:
    chip.write(t, bytes([sub_address]))
    return chip.read(t, n, 9 / 400e3)


def running(full_scale: int = 0) -> Lis3mdl:
    chip = Lis3mdl(FIELD, Specimen(strict=True))
    write(chip, 1.0, 0x20, 0x7C)
    write(chip, 1.0, 0x21, full_scale << 5)
    write(chip, 1.0, 0x22, 0x00)
    return chip


def test_it_is_powered_down_at_reset() -> None:
    chip = Lis3mdl(FIELD, Specimen(strict=True))
    assert [read(chip, 1.0, r)[0] for r in (0x0F, 0x20, 0x21, 0x22, 0x23, 0x24)] == [0x3D, 0x10, 0, 3, 0, 0]
    assert read(chip, 9.0, 0x27)[0] == 0


def test_bursts_advance_only_with_the_top_bit_of_the_sub_address() -> None:
    chip = running()
    x = read(chip, 2.0, 0x28)[0]
    assert read(chip, 2.0, 0x28, 6) == bytes([x] * 6)
    assert len(set(read(chip, 2.0, 0x28 | 0x80, 6))) > 1


@pytest.mark.parametrize(("code", "per_gauss"), [(0, 6842), (1, 3421), (2, 2281), (3, 1711)])
def test_scale_is_that_of_the_range(code: int, per_gauss: int) -> None:
    words = np.frombuffer(read(running(code), 2.0, 0xA8, 6), "<i2")
    assert words.tolist() == [round(g * per_gauss) for g in (0.2, -0.1, 0.4)]


def test_status_is_set_at_80_hz_cleared_by_reading_and_shows_overrun() -> None:
    chip = running()
    assert read(chip, 1.0 + 0.9 / 80, 0x27)[0] == 0
    assert read(chip, 1.0 + 1.1 / 80, 0x27)[0] == 0x0F
    read(chip, 1.0 + 1.2 / 80, 0xA8, 6)
    assert read(chip, 1.0 + 1.3 / 80, 0x27)[0] == 0
    assert read(chip, 1.0 + 3.1 / 80, 0x27)[0] == 0xFF


def test_temperature_has_eight_lsb_per_degree_about_25() -> None:
    assert int.from_bytes(read(running(), 2.0, 0xAE, 2), "little", signed=True) == 48
