"""Drivers of single chips on the emulated bus, compared with the data sheets."""

from array import array
from types import SimpleNamespace

import numpy as np
import pytest
from chip_search import MAG_DRIVERS, search
from drivers.akm import AK09916, AK8963
from drivers.icm20948 import ICM20948
from drivers.lis3mdl import LIS3MDL
from drivers.lsm6ds33 import LSM6DS33
from drivers.mmc5983ma import MMC5983MA
from drivers.mpu6050 import MPU6050
from drivers.mpu9250 import MPU9250
from drivers.nrf24 import Nrf24
from drivers.qmc5883l import QMC5883L
from emulated_bus import EmulatedBus

from fakes.fake_port import PORT_TICKS
from hubodo.emulator.chips.icm20948 import Icm20948
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.lis3mdl import Lis3mdl
from hubodo.emulator.chips.lsm6ds33 import Lsm6ds33
from hubodo.emulator.chips.mmc5983ma import Mmc5983ma
from hubodo.emulator.chips.mpu6050 import Mpu6050, Mpu6500, Mpu9250
from hubodo.emulator.chips.qmc5883l import Qmc5883l
from hubodo.emulator.motion import StillMotion
from hubowire.messages import Part
from virtual_runs import unique_motion


@pytest.mark.parametrize(
    ("driver", "silicon", "identity", "part", "per_degree", "at_zero"),
    [
        (MPU6050, Mpu6050, 0x68, Part.MPU6050, 340.0, 36.53),  # PS-MPU-6000A
        (MPU9250, Mpu6500, 0x70, Part.MPU6500, 333.87, 21.0),  # RM-MPU-6500A
        (MPU9250, Mpu6500, 0x71, Part.MPU6500, 333.87, 21.0),
        (MPU9250, Mpu6500, 0x73, Part.MPU6500, 333.87, 21.0),
    ],
)
def test_an_mpu_is_recognised_by_its_id_with_its_own_temperature_scale(
    driver, silicon, identity, part, per_degree, at_zero
):
    chip = driver(EmulatedBus(silicon(unique_motion(1), Specimen(who_am_i=identity))))
    assert (chip.who_am_i, part) == (identity, chip.PART)
    assert chip.temperature_lsb_udegc == pytest.approx(1e6 / per_degree, abs=0.5)
    assert chip.temperature_offset_udegc == at_zero * 1e6


@pytest.mark.parametrize(
    ("driver", "silicon", "samples", "level"),
    [
        *((MPU6050, Mpu6050, n, level) for n, level in ((40, 40), (85, 85), (86, -1), (300, -1))),
        *((MPU9250, Mpu6500, n, level) for n, level in ((40, 40), (42, 42), (43, -1), (300, -1))),
    ],
)
def test_the_fifo_of_an_mpu_holds_1024_or_512_bytes_and_reports_an_overrun(driver, silicon, samples, level):
    """A sample has 12 bytes."""
    chip = driver(EmulatedBus(silicon(unique_motion(4)), call_us=0), odr_hz=100, fifo=True)
    PORT_TICKS.now_us += samples * 10_000 + 5_000
    assert chip.fifo_level() == level
    chip.fifo_flush()
    PORT_TICKS.now_us += 25_000
    assert chip.fifo_level() in (2, 3)


@pytest.mark.parametrize(("words", "next_word", "complete"), [(14, 2, 1), (16, 4, 2), (3, 2, 0), (15, 0, 2)])
def test_the_fifo_of_an_lsm6ds33_resumes_at_the_next_complete_sample(words, next_word, complete):
    """Incomplete samples are discarded; next_word: position within a sample of six words."""
    chip = LSM6DS33(EmulatedBus(Lsm6ds33(unique_motion(4)), call_us=0), fifo=True)
    thrown = []

    def read(_address, register, into):
        if register == 0x3A:
            into[:] = bytes([words, 0, next_word, 0])[: len(into)]
        else:
            thrown.append(len(into) // 2)

    chip.i2c = SimpleNamespace(readfrom_mem_into=read)
    assert chip.fifo_level() == complete
    assert sum(thrown) == (6 - next_word if next_word and words >= 6 - next_word else 0)


@pytest.mark.parametrize(
    ("reads", "complete", "n_reads"),
    [
        ([(0xF2, 0x01)], 83, 1),  # 498 words: too far from a carry for a torn read
        ([(0xFE, 0x01), (0xFE, 0x01)], 85, 2),  # 510 words, twice the same
        ([(0xFC, 0x01), (0x02, 0x01)], 43, 2),  # 252, which became 258 between the two bytes
        ([(0xFC, 0x01), (0xFC, 0x00), (0xFC, 0x00)], 42, 3),
        ([(0x00, 0x4C)], -1, 1),
    ],
)
def test_a_fifo_level_near_a_carry_is_accepted_if_two_reads_agree(reads, complete, n_reads):
    """reads: low and high byte of each read of the level; the high byte has the overrun flag."""
    chip = LSM6DS33(EmulatedBus(Lsm6ds33(unique_motion(4)), call_us=0), fifo=True)
    left = list(reads)

    def read(_address, register, into):
        assert register == 0x3A
        into[:] = bytes([*left.pop(0), 0, 0])[: len(into)]

    chip.i2c = SimpleNamespace(readfrom_mem_into=read)
    assert chip.fifo_level() == complete
    assert len(reads) - len(left) == n_reads


@pytest.mark.parametrize(("gauss", "per_gauss"), [(4, 6842), (8, 3421), (12, 2281), (16, 1711)])
def test_the_magnetometer_reads_all_axes_in_order(gauss, per_gauss):
    """The steps per gauss are those of ST DocID024204, table 3."""
    field = (21e-6, -4e-6, -43e-6)
    chip = LIS3MDL(EmulatedBus(Lis3mdl(StillMotion(field_tesla=field))), range_gauss=gauss)
    words = array("h", bytes(10))
    assert chip.read_into(words, 1) == 0
    PORT_TICKS.now_us += 150_000
    assert chip.read_into(words, 1) == 1
    assert words.tolist() == [0, *(pytest.approx(tesla * 1e4 * per_gauss, abs=0.51) for tesla in field), 0]
    assert chip.lsb_ft == pytest.approx(1e11 / per_gauss, rel=1e-7)


@pytest.mark.parametrize(("gauss", "per_gauss"), [(2, 12000), (8, 3000)])
@pytest.mark.parametrize("rate_hz", [10, 200])
def test_the_qmc5883l_is_recognised_and_reads_all_axes_at_its_rate(gauss, per_gauss, rate_hz):
    """The steps per gauss are those of QST's data sheet 1.0, table 2."""
    field, chips = (21e-6, -4e-6, -43e-6), []
    bus = EmulatedBus(Qmc5883l(StillMotion(field_tesla=field)))
    driver, address, who_am_i = search(bus, MAG_DRIVERS, chips)
    assert (driver, address, who_am_i, chips) == (QMC5883L, 0x0D, 0xFF, [])
    chip = driver(bus, address, odr_hz=rate_hz, range_gauss=gauss)
    words = array("h", bytes(10))
    assert chip.read_into(words, 1) == 0 and chip.intact()
    assert count_samples(chip, words) == pytest.approx(rate_hz, abs=1)
    assert words.tolist() == [0, *(pytest.approx(tesla * 1e4 * per_gauss, abs=0.51) for tesla in field), 0]
    assert chip.lsb_ft == pytest.approx(1e11 / per_gauss, rel=1e-7)
    bus.writeto_mem(address, 0x0A, b"\x80")
    assert not chip.intact(), "a reset is noticed"
    chip.configure()
    assert chip.intact()


@pytest.mark.parametrize("rate_hz", [10, 20, 50, 100, 200])
def test_the_mmc5983ma_is_recognised_and_reads_all_axes_at_its_rate(rate_hz):
    """The steps per gauss are those of Memsic's data sheet, revision A, with 16 bits."""
    field, chips = (21e-6, -4e-6, -43e-6), []
    silicon = Mmc5983ma(StillMotion(field_tesla=field), Specimen(strict=True))
    bus = EmulatedBus(silicon)
    driver, address, who_am_i = search(bus, MAG_DRIVERS, chips)
    assert (driver, address, who_am_i, chips) == (MMC5983MA, 0x30, 0x30, [])
    chip = driver(bus, address, odr_hz=rate_hz)
    words = array("h", bytes(10))
    assert chip.read_into(words, 1) == 0 and chip.intact()
    assert count_samples(chip, words) == pytest.approx(rate_hz, abs=1)
    assert words.tolist() == [0, *(pytest.approx(tesla * 1e4 * 4096, abs=0.51) for tesla in field), 0]
    assert chip.lsb_ft == pytest.approx(1e11 / 4096, rel=1e-7)
    assert not silicon.anomalies


INNER_MAGS = {"icm20948": (Icm20948, ICM20948, AK09916, 0x09), "mpu9250": (Mpu9250, MPU9250, AK8963, 0x48)}


def inner_magnetometer(imu, field):
    """Return the emulated IMU, its bus and the magnetometer's driver, with the IMU configured."""
    silicon, imu_driver, mag_driver, _ = INNER_MAGS[imu]
    part = silicon(StillMotion(field_tesla=field), Specimen(strict=True))
    bus = EmulatedBus(part)
    assert search(bus, MAG_DRIVERS, []) is None, "an inner bus is not connected at power-on"
    imu_driver(bus)
    return part, bus, mag_driver


@pytest.mark.parametrize(
    "imu, rate_hz", [("icm20948", 10), ("icm20948", 100), ("mpu9250", 8), ("mpu9250", 100)]
)
def test_an_inner_magnetometer_reads_the_field_in_the_axes_of_its_imu(imu, rate_hz):
    field, chips = (21e-6, -4e-6, -43e-6), []
    part, bus, mag_driver = inner_magnetometer(imu, field)
    driver, address, who_am_i = search(bus, MAG_DRIVERS, chips)
    assert (driver, address, who_am_i, chips) == (mag_driver, 0x0C, INNER_MAGS[imu][3], [])
    chip = driver(bus, address, odr_hz=rate_hz)
    words = array("h", bytes(10))
    assert chip.read_into(words, 1) == 0 and chip.intact()
    assert count_samples(chip, words) == pytest.approx(rate_hz, abs=1)
    # Half a step of the chip, and one of the adjusted sensitivity.
    assert words.tolist() == [0, *(pytest.approx(tesla / 0.15e-6, abs=1.6) for tesla in field), 0]
    assert chip.lsb_ft == 150_000_000
    assert not part.magnetometer.anomalies
    part.magnetometer.power_on(bus.t)
    assert not chip.intact(), "a reset is noticed"
    chip.configure()
    assert chip.intact() and count_samples(chip, words) > 0


@pytest.mark.parametrize("imu", INNER_MAGS)
def test_a_field_beyond_the_range_of_an_inner_magnetometer_is_no_sample(imu):
    _, bus, mag_driver = inner_magnetometer(imu, (0.0, 0.0, -6e-3))
    assert count_samples(mag_driver(bus, odr_hz=100), array("h", bytes(10))) == 0


def count_samples(chip, words):
    """Return the number of samples that words[1:4] receives in a second."""
    samples, end_us = 0, PORT_TICKS.now_us + 1_000_000
    while PORT_TICKS.now_us < end_us:
        samples += chip.read_into(words, 1)
        PORT_TICKS.now_us += 1000
    return samples


class EmulatedNrf24:
    """An emulated nRF24L01+ on SPI (product specification 1.0, tables 20 and 28)."""

    def __init__(self):
        self.registers, self.commands, self.enabled_at = {}, [], []
        self.times_us = []
        self.waiting, self.selected, self.enabled = [], False, None
        self.ignored_register = None
        self.csn = SimpleNamespace(value=self._select)
        self.ce = SimpleNamespace(value=self._enable)

    def _select(self, level):
        """Set the select line: low begins a command, high ends it."""
        assert level in (0, 1) and self.selected == bool(level)
        self.selected = not level

    def _enable(self, level):
        assert level in (0, 1)
        self.enabled = bool(level)
        self.enabled_at.append((self.enabled, len(self.commands)))
        self.times_us.append(PORT_TICKS.now_us)

    def write(self, out):
        self.write_readinto(out, bytearray(len(out)))

    def write_readinto(self, out, into):
        assert self.selected and len(out) == len(into)
        out = bytes(out)
        into[0] = 0x0E
        self.commands.append(out)
        self.times_us.append(PORT_TICKS.now_us)
        if out[0] >> 5 == 1:
            self.registers[out[0] & 0x1F] = bytes(5) if out[0] & 0x1F == self.ignored_register else out[1:]
        elif out[0] == 0x60:
            into[1] = len(self.waiting[0]) if self.waiting else 0
        elif out[0] == 0x61:
            into[1:] = self.waiting.pop(0)
        elif out[0] == 0xE2:
            self.waiting.clear()
        elif out[0] < 0x20 and len(into) > 1:
            into[1:] = self.registers.get(out[0], bytes(1))[: len(into) - 1]


@pytest.mark.parametrize(("kbps", "setup"), [(250, 0x26), (1000, 0x06), (2000, 0x0E)])
def test_a_radio_is_configured_while_disabled(kbps, setup):
    chip = EmulatedNrf24()
    Nrf24(chip, chip.csn, chip.ce, 76, kbps)
    assert chip.enabled_at == [(False, 0)] and not chip.selected
    expected = {0x03: 3, 0x05: 76, 0x06: setup, 0x1D: 7, 0x1C: 0x3F, 0x01: 0x3F, 0x07: 0x70}
    assert {register: value[0] for register, value in chip.registers.items()} == expected
    assert bytes([0xE1]) in chip.commands and bytes([0xE2]) in chip.commands
    with pytest.raises(ValueError, match="radio_kbps 500"):
        Nrf24(chip, chip.csn, chip.ce, 76, 500)
    for register in (0x03, 0x05):
        chip = EmulatedNrf24()
        chip.ignored_register = register
        with pytest.raises(OSError, match="no nRF24"):
            Nrf24(chip, chip.csn, chip.ce, 76, kbps)


def test_a_radio_sends_to_one_address_and_listens_to_several():
    chip = EmulatedNrf24()
    radio = Nrf24(chip, chip.csn, chip.ce, 76, 1000)
    radio.send_to(b"\x01abcd", 15, 500)
    assert chip.registers[0x10] == chip.registers[0x0A] == b"\x01abcd"
    assert (chip.registers[0x02], chip.registers[0x04], chip.registers[0x00]) == (b"\x01", b"\x1f", b"\x0e")
    assert chip.enabled
    # Tpd2stby, table 16: the crystal needs 4.5 ms, which the driver waits after power-on and after power-up.
    first, second = (np.diff(chip.times_us)[k] for k in (0, -1))
    assert 4500 <= first < 10_000 and 4500 <= second < 10_000
    radio.listen_to([b"\x01abcd", b"\x02abcd", b"\x03abcd"])
    assert (chip.registers[0x0B], chip.registers[0x0C], chip.registers[0x0D]) == (
        b"\x01abcd",
        b"\x02",
        b"\x03",
    )
    assert (chip.registers[0x02], chip.registers[0x00]) == (b"\x0e", b"\x0f")


def test_packets_are_sent_and_received_completely():
    chip = EmulatedNrf24()
    radio = Nrf24(chip, chip.csn, chip.ce, 76, 1000)
    for size in (1, 32):
        packet = bytes(range(7, 7 + size))
        radio.out[1 : 1 + size] = packet
        radio.write(size)
        radio.write(size, acknowledged=False)
        radio.answer(2, size)
        assert chip.commands[-3:] == [bytes([command]) + packet for command in (0xA0, 0xB0, 0xAA)]
    chip.waiting = [b"x", bytes(range(32))]
    assert (radio.read(), bytes(radio.came[1:2])) == (1, b"x")
    assert (radio.read(), bytes(radio.came[1:])) == (32, bytes(range(32)))
    assert radio.read() == 0
    chip.waiting = [bytes(33)]
    assert radio.read() == 0 and not chip.waiting, "an invalid length: the queue is discarded"
    chip.registers[0x09] = b"\x01"
    assert (radio.is_strong(), radio.status()) == (1, 0x0E)
    chip.registers[0x09] = b"\x00"
    assert radio.is_strong() == 0
    radio.flush()
    assert chip.commands[-1] == b"\xe1"
    radio.clear(0x40)
    assert chip.registers[0x07] == b"\x40" and not chip.selected


@pytest.mark.parametrize("word", [-32768, -300, -1, 0, 1, 255, 256, 0x1234, 32767])
@pytest.mark.parametrize(
    "driver, silicon, register, order",
    [(LSM6DS33, Lsm6ds33, 0x20, "little"), (MPU6050, Mpu6050, 0x41, "big")],  # OUT_TEMP_L; TEMP_OUT_H
)
def test_the_temperature_is_read_beside_the_fifo_in_the_byte_order_of_the_data_sheet(
    driver, silicon, register, order, word
):
    chip = driver(EmulatedBus(silicon(unique_motion(1), Specimen())), fifo=True)

    def read(address, first, raw):
        # The following registers have other values.
        returned = word.to_bytes(2, order, signed=True) + b"\xa5\x5a\xa5\x5a\xa5\x5a"
        assert (address, first) == (chip.address, register)
        raw[:] = returned[: len(raw)]

    chip.i2c = SimpleNamespace(readfrom_mem_into=read)
    chip.read_temperature()
    assert chip.temperature_raw == word
