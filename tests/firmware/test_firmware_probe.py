"""Recognition of the IMU: `probe` of each driver, in order."""

import sys
from types import SimpleNamespace

import parts
import pytest
from drivers.mpu6050 import MPU6050
from emulated_bus import EmulatedBus
from parts import Parts

from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.lsm6ds33 import Lsm6ds33
from hubodo.emulator.chips.mpu6050 import Mpu6050
from hubodo.emulator.chips.registers import Register, RegisterChip
from hubodo.emulator.motion import StillMotion

DRIVER = '''"""ICM-20948 (only its identification, for this test)."""

from drivers.chip import Chip


class ICM20948(Chip):
    """WHO_AM_I 0xEA in register 0 (DS-000189)."""

    WHO_AM_I_REGISTER = 0x00
    WHO_AM_I = (0xEA,)
'''


def icm20948():
    """Return a chip at 0x68 whose registers differ from those of an MPU-6050 (DS-000189, bank 0)."""
    registers = {0x00: Register("WHO_AM_I"), 0x06: Register("PWR_MGMT_1", reset=0x41, writable=0xFF)}
    return RegisterChip("imu", 0x68, registers, (0x00, 0xEA))


def probe_chips(*chips, drivers=None):
    """Return name, address and WHO_AM_I of the recognised IMU, and the other chips listed."""
    search = object.__new__(Parts)
    search._board = SimpleNamespace(i2c=EmulatedBus(*chips))
    search.chips = []
    imu = search._probe(drivers or parts.IMU_DRIVERS)
    return (imu and (imu[0].__name__, *imu[1:])), search.chips


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
    chip = icm20948()
    assert probe_chips(chip) == (None, [(0x68, 0x00, 0)])
    assert not chip.writes
    with pytest.raises(OSError, match="0x68"):
        MPU6050(EmulatedBus(chip))


@pytest.mark.parametrize("first", [True, False])
def test_a_new_driver_recognises_its_chip_beside_the_others(tmp_path, monkeypatch, first):
    (tmp_path / "icm20948.py").write_text(DRIVER)
    monkeypatch.syspath_prepend(tmp_path)
    row = ("icm20948", "ICM20948", (0x68, 0x69))
    drivers = (row, *parts.IMU_DRIVERS) if first else (*parts.IMU_DRIVERS, row)
    try:
        assert probe_chips(icm20948(), drivers=drivers) == (("ICM20948", 0x68, 0xEA), [])
        assert probe_chips(mpu(), drivers=drivers) == (("MPU6050", 0x68, 0x68), [])
        assert probe_chips(lsm(), drivers=drivers) == (("LSM6DS33", 0x6B, 0x69), [])
    finally:
        sys.modules.pop("icm20948", None)


def test_an_unknown_chip_is_listed_once():
    rows = (*parts.IMU_DRIVERS, ("drivers.lsm6ds33", "LSM6DS33", (0x68, 0x69)))
    assert probe_chips(icm20948(), drivers=rows) == (None, [(0x68, 0x00, 0)])
