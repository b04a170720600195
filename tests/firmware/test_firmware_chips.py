"""Drivers of single chips on the emulated bus, against what the data sheets say."""

from array import array

import pytest
from drivers.lis3mdl import LIS3MDL
from drivers.mpu6050 import MPU6050
from emulated_bus import EmulatedBus

from fakes.fake_port import PORT_TICKS
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.lis3mdl import Lis3mdl
from hubodo.emulator.chips.mpu6050 import Mpu6050, Mpu6500
from hubodo.emulator.motion import StillMotion
from hubowire.messages import Part
from virtual_runs import unique_motion


@pytest.mark.parametrize(
    ("silicon", "identity", "part", "per_degree", "at_zero"),
    [
        (Mpu6050, 0x68, Part.MPU6050, 340.0, 36.53),  # PS-MPU-6000A
        (Mpu6500, 0x70, Part.MPU6500, 333.87, 21.0),  # RM-MPU-6500A
        (Mpu6500, 0x71, Part.MPU6500, 333.87, 21.0),
        (Mpu6500, 0x73, Part.MPU6500, 333.87, 21.0),
    ],
)
def test_an_mpu_is_known_by_its_id_and_read_by_its_own_thermometer(
    silicon, identity, part, per_degree, at_zero
):
    chip = MPU6050(EmulatedBus(silicon(unique_motion(1), Specimen(who_am_i=identity))))
    assert (chip.who_am_i, part) == (identity, chip.PART)
    assert chip.temperature_lsb_udegc == pytest.approx(1e6 / per_degree, abs=0.5)
    assert chip.temperature_offset_udegc == at_zero * 1e6


@pytest.mark.parametrize(("samples", "level"), [(40, 40), (85, 85), (86, -1), (300, -1)])
def test_the_fifo_of_an_mpu_holds_85_samples_and_says_when_it_ran_over(samples, level):
    """1024 bytes, 12 a sample."""
    chip = MPU6050(EmulatedBus(Mpu6050(unique_motion(4)), call_us=0), odr_hz=100, fifo=True)
    PORT_TICKS.now_us += samples * 10_000 + 5_000
    assert chip.fifo_level() == level
    chip.fifo_flush()
    PORT_TICKS.now_us += 25_000
    assert chip.fifo_level() in (2, 3)


@pytest.mark.parametrize(("gauss", "per_gauss"), [(4, 6842), (8, 3421), (12, 2281), (16, 1711)])
def test_the_magnetometer_reads_each_axis_of_the_field_in_its_own_place(gauss, per_gauss):
    """Steps per gauss: ST DocID024204, table 3."""
    field = (21e-6, -4e-6, -43e-6)
    chip = LIS3MDL(EmulatedBus(Lis3mdl(StillMotion(field_tesla=field))), range_gauss=gauss)
    words = array("h", bytes(10))
    assert chip.read_into(words, 1) == 0
    PORT_TICKS.now_us += 150_000
    assert chip.read_into(words, 1) == 1
    assert words.tolist() == [0, *(pytest.approx(tesla * 1e4 * per_gauss, abs=0.51) for tesla in field), 0]
    assert chip.lsb_ft == pytest.approx(1e11 / per_gauss, rel=1e-7)
