"""Recognition of the IMU: `probe` of each driver, in order."""

import sys

import chip_search
import pytest
from drivers.mpu6050 import MPU6050
from emulated_bus import EmulatedBus

from hubodo.emulator.chips.bmi088 import Bmi088
from hubodo.emulator.chips.bmi270 import Bmi270
from hubodo.emulator.chips.icm20948 import Icm20948
from hubodo.emulator.chips.icm42688 import Icm42688
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.lsm6ds33 import Lsm6ds33
from hubodo.emulator.chips.mpu6050 import Mpu6050
from hubodo.emulator.chips.registers import Register, RegisterChip
from hubodo.emulator.motion import StillMotion

DRIVER = '''"""BMI160 (only its identification, for this test)."""

from drivers.chip import Chip


class BMI160(Chip):
    """WHO_AM_I 0xD1 in register 0."""

    WHO_AM_I_REGISTER = 0x00
    WHO_AM_I = (0xD1,)
'''


def bmi160():
    """Return a chip at 0x68 whose registers differ from those of an MPU-6050."""
    registers = {0x00: Register("CHIP_ID"), 0x7E: Register("CMD", writable=0xFF)}
    return RegisterChip("imu", 0x68, registers, (0x00, 0xD1))


def probe_chips(*chips, drivers=None):
    """Return name, address and WHO_AM_I of the recognised IMU, and the other chips listed."""
    listed = []
    imu = chip_search.search(EmulatedBus(*chips), drivers or chip_search.IMU_DRIVERS, listed)
    return (imu and (imu[0].__name__, *imu[1:])), listed


def lsm(**values):
    return Lsm6ds33(StillMotion(), Specimen(**values))


def mpu(**values):
    return Mpu6050(StillMotion(), Specimen(**values))


def test_each_supported_chip_is_recognised_and_the_first_of_two_is_used():
    assert probe_chips(lsm()) == (("LSM6DS33", 0x6B, 0x69), [])
    assert probe_chips(mpu()) == (("MPU6050", 0x68, 0x68), [])
    assert probe_chips(mpu(), lsm()) == (("LSM6DS33", 0x6B, 0x69), [(0x68, 0x68, 0)])
    assert probe_chips() == (None, [])


def test_a_clone_of_an_mpu_is_recognised_by_its_power_register_even_when_configured():
    chip = mpu(who_am_i=0x34)
    bus = EmulatedBus(chip)
    assert MPU6050.probe(bus, 0x68) == 0x34
    MPU6050(bus)
    assert MPU6050.probe(bus, 0x68) == 0x34


def test_a_chip_of_another_family_at_an_mpus_address_is_listed_and_not_configured():
    chip = bmi160()
    assert probe_chips(chip) == (None, [(0x68, 0x00, 0)])
    assert not chip.writes
    with pytest.raises(OSError, match="0x68"):
        MPU6050(EmulatedBus(chip))


@pytest.mark.parametrize("first", [True, False])
def test_a_new_driver_recognises_its_chip_beside_the_others(tmp_path, monkeypatch, first):
    (tmp_path / "bmi160.py").write_text(DRIVER)
    monkeypatch.syspath_prepend(tmp_path)
    row = ("bmi160", "BMI160", (0x68, 0x69), 0x00, (0xD1,))
    drivers = (row, *chip_search.IMU_DRIVERS) if first else (*chip_search.IMU_DRIVERS, row)
    try:
        assert probe_chips(bmi160(), drivers=drivers) == (("BMI160", 0x68, 0xD1), [])
        assert probe_chips(mpu(), drivers=drivers) == (("MPU6050", 0x68, 0x68), [])
        assert probe_chips(lsm(), drivers=drivers) == (("LSM6DS33", 0x6B, 0x69), [])
    finally:
        sys.modules.pop("bmi160", None)


def test_an_unknown_chip_is_listed_once():
    rows = (*chip_search.IMU_DRIVERS, ("drivers.lsm6ds33", "LSM6DS33", (0x68, 0x69), 0x0F, (0x69,)))
    assert probe_chips(bmi160(), drivers=rows) == (None, [(0x68, 0x00, 0)])


@pytest.mark.parametrize("kind", [Icm20948, Icm42688, Bmi270, Bmi088])
def test_an_mpu6050_does_not_claim_the_chip_of_another_driver(kind):
    """Even where the register that is PWR_MGMT_1 of an MPU has its value."""
    chip = kind(StillMotion())
    bus = EmulatedBus(chip)
    read = bus.readfrom_mem_into

    def read_or_lie(address, register, buffer):
        read(address, register, buffer)
        if register == 0x6B:
            buffer[0] = 0x40

    bus.readfrom_mem_into = read_or_lie
    assert MPU6050.probe(bus, 0x68) == -1
    mpu_only = [row for row in chip_search.IMU_DRIVERS if row[1] == "MPU6050"]
    assert probe_chips(kind(StillMotion()), drivers=mpu_only)[0] is None
