"""Every IMU driver on its emulated chip: scales, rates, temperature, FIFO, and its row of the search."""

import math
import random
from array import array

import chip_search
import numpy as np
import pytest
from drivers.spi_bus import SPI_DRIVERS, SpiBus, search_spi
from emulated_bus import EmulatedBus, EmulatedSpi, spi_bus

from fakes.fake_port import PORT_TICKS
from hubodo.earth import STANDARD_GRAVITY
from hubodo.emulator.chips.bmi270 import Bmi270
from hubodo.emulator.chips.catalogue import IMU_CHIPS
from hubodo.emulator.chips.faults import MissedSamples
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.chips.registers import Register, RegisterChip
from hubodo.emulator.motion import RecordedMotion, StillMotion
from virtual_runs import unique_motion


@pytest.fixture(autouse=True)
def configuration(tmp_path, monkeypatch):
    """A file for the chip that needs one: as long and with the same beginning as Bosch's."""
    path = tmp_path / "bmi270.bin"
    path.write_bytes(b"\xc8\x2e" + random.Random(7).randbytes(8190))
    monkeypatch.setattr("drivers.bmi270.CONFIGURATION", str(path))
    return path


ROWS = {row[1]: row for row in (*chip_search.IMU_DRIVERS, *SPI_DRIVERS)}
SHARED_DRIVERS = {"mpu6500": "MPU9250", "lsm6dsv320x": "LSM6DSV"}
CHIPS = [(kind, SHARED_DRIVERS.get(kind.chip_name, kind.chip_name.upper())) for kind in IMU_CHIPS]
each_chip = pytest.mark.parametrize(("silicon", "driver"), CHIPS, ids=lambda x: getattr(x, "chip_name", x))
ON_SPI = [
    (kind, name)
    for kind, chip_driver in CHIPS
    for _, name, *_ in SPI_DRIVERS
    if name in (chip_driver, f"{chip_driver}Spi")
]
each_bus = pytest.mark.parametrize(
    ("silicon", "driver", "bus_of"),
    [(*chip, EmulatedBus) for chip in CHIPS] + [(*chip, spi_bus) for chip in ON_SPI],
    ids=lambda x: getattr(x, "chip_name", getattr(x, "__name__", x)),
)


def load(name):
    module, name, *_ = ROWS[name]
    return getattr(__import__(module, None, None, (name,)), name)


def load_silicon(chip_name):
    return next(kind for kind in IMU_CHIPS if kind.chip_name == chip_name)


def fifo_rows(chip, batch):
    """Read a batch from the FIFO; return its rows, and True if the driver reports it as torn."""
    rows = bytearray(12 * batch)
    torn = chip.fifo_read_into(rows)
    return np.frombuffer(bytes(rows), "<i2").reshape(-1, 6), bool(torn)


@pytest.mark.parametrize(("silicon", "driver"), ON_SPI)
def test_the_search_on_spi_finds_the_chip_also_after_a_restart_of_the_board(silicon, driver):
    spi, listed = EmulatedSpi(silicon(StillMotion())), []
    for _ in range(2):
        imu = search_spi(SpiBus(spi, spi), listed)
        assert imu == (load(driver), 0, load(driver).WHO_AM_I[0]) and not listed


@pytest.mark.parametrize("identity, is_listed", [(0x71, True), (0x00, False), (0xFF, False)])
def test_another_chip_on_spi_is_listed_and_an_open_line_is_none(identity, is_listed):
    registers = {register: Register("ID", identity) for register in (0x00, 0x01, 0x75)}
    listed = []
    assert search_spi(spi_bus(RegisterChip("imu", 0, registers, (0x75, identity))), listed) is None
    assert listed == [(0, identity, 0)] * is_listed


def jerk_steps(chip):
    """Return the change of acceleration of `unique_motion` in 1.1 periods, in steps of the chip."""
    jerk = 5 * 4.7 / STANDARD_GRAVITY
    return 1 + jerk * 1.1e3 / chip.rate_mhz / (chip.accel_lsb_ng * 1e-9)


@each_chip
def test_the_search_finds_the_chip_by_the_identity_of_its_driver(silicon, driver):
    listed = []
    imu = chip_search.search(
        EmulatedBus(silicon(StillMotion(), Specimen(strict=True))), chip_search.IMU_DRIVERS, listed
    )
    assert imu is not None and imu[0] is load(driver) and not listed
    *_, register, identities = ROWS[driver]
    assert register == load(driver).WHO_AM_I_REGISTER
    assert identities in (load(driver).WHO_AM_I, ())


@each_bus
def test_every_range_has_the_scale_of_the_chip(silicon, driver, bus_of):
    """A rate and an acceleration at 60 % of each range appear in the driver's steps."""
    kind = load(driver)
    dps = [row[0] for row in kind.RANGES_DPS]
    g = [row[0] for row in kind.RANGES_G]
    for i in range(max(len(dps), len(g))):
        range_dps, range_g = dps[i % len(dps)], g[i % len(g)]
        rate = np.array([0.6, -0.5, 0.1]) * math.radians(range_dps)
        force = np.array([-0.2, 0.6, 0.55]) * range_g * STANDARD_GRAVITY
        bus = bus_of(silicon(StillMotion(rate=tuple(rate), force=tuple(force)), Specimen(strict=True)))
        chip = kind(bus, odr_hz=kind.RATES_HZ[1][0], range_dps=range_dps, range_g=range_g)
        PORT_TICKS.now_us += 100_000
        words = array("h", bytes(14))
        assert chip.read_into(words, 1) == 1 and not chip.read_into(array("h", bytes(12)), 0)
        got = np.array(words[1:])
        assert got[:3] == pytest.approx(np.degrees(rate) / (chip.gyro_lsb_ndps * 1e-9), abs=0.6)
        assert got[3:] == pytest.approx(force / STANDARD_GRAVITY / (chip.accel_lsb_ng * 1e-9), abs=0.6)
        assert (chip.range_dps, chip.range_g) == (range_dps, range_g)


@each_bus
def test_every_rate_is_that_of_the_chip_and_its_fifo_holds_consecutive_samples(silicon, driver, bus_of):
    kind = load(driver)
    for hz, *_ in kind.RATES_HZ:
        part = silicon(unique_motion(3), Specimen(strict=True))
        chip = kind(bus_of(part, call_us=0), odr_hz=hz, fifo=True)
        batch = 5
        chip.shape(batch)
        PORT_TICKS.now_us += round(12.5e9 / chip.rate_mhz)
        # The chip may have sampled between the flush and the end of its configuration.
        assert chip.fifo_level() in (12, 13), hz
        rows, torn = fifo_rows(chip, batch)
        again, torn_again = fifo_rows(chip, batch)
        truth = part.truth().raw
        first = next(k for k in range(len(truth)) if np.array_equal(truth[k, :3], rows[0, :3]))
        difference = np.concatenate([rows, again]) - truth[first : first + 10]
        # A BMI088 has accelerations that are not sampled at the times of the gyro.
        accel_tolerance = silicon.chip_name == "bmi088" and jerk_steps(chip)
        assert not difference[:, :3].any() and np.abs(difference[:, 3:]).max() <= accel_tolerance, hz
        assert not torn and not torn_again and chip.intact()
        # Another driver object on a running chip knows that it was running.
        assert kind(chip.i2c).was_running


@each_bus
@pytest.mark.parametrize("degrees", [-20.0, 25.0, 61.5])
def test_the_temperature_is_that_of_the_chip(silicon, driver, bus_of, degrees):
    chip = load(driver)(bus_of(silicon(StillMotion(degrees=degrees), Specimen(strict=True))))
    PORT_TICKS.now_us += 100_000
    chip.read_temperature()
    udegc = chip.temperature_raw * chip.temperature_lsb_udegc + chip.temperature_offset_udegc
    assert udegc * 1e-6 == pytest.approx(degrees, abs=0.6 * chip.temperature_lsb_udegc * 1e-6 + 0.005)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("chip_name", ["lsm6dso", "lsm6dsv", "icm42688"])
def test_samples_that_the_chip_skipped_show_in_its_own_time_stamps(chip_name, n):
    silicon, driver = next((kind, load(name)) for kind, name in CHIPS if kind.chip_name == chip_name)
    faults = (MissedSamples(0.5, n),)
    chip = driver(
        EmulatedBus(silicon(unique_motion(2), Specimen(faults=faults)), call_us=0),
        odr_hz=driver.RATES_HZ[5][0],
        fifo=True,
    )
    chip.shape(8)
    torn = []
    step_us = round(8e9 / chip.rate_mhz)
    for _ in range(900_000 // step_us):
        PORT_TICKS.now_us += step_us
        torn += [fifo_rows(chip, 8)[1]] if chip.fifo_level() >= 8 else []
    assert sum(torn) == 1 and abs(torn.index(True) - 500_000 // step_us) < 3


@pytest.mark.parametrize(
    ("chip_name", "odr_error", "reported_error"),
    [("lsm6dso", 0.0225, 0.0225), ("lsm6dsv", -0.0169, -0.0169), ("lsm6dsv320x", 0.02, 15 * 0.0013)],
)
def test_the_factory_measurement_of_the_rate_sets_the_period(chip_name, odr_error, reported_error):
    silicon, driver = next((kind, load(name)) for kind, name in CHIPS if kind.chip_name == chip_name)
    _, nominal_mhz, _ = driver.RATES_HZ[5]
    chip = driver(
        EmulatedBus(silicon(StillMotion(), Specimen(odr_error=odr_error))), odr_hz=driver.RATES_HZ[5][0]
    )
    assert chip.rate_mhz == pytest.approx(nominal_mhz * (1 + reported_error), abs=1)


@pytest.mark.parametrize("range_g", [2, 16])
@pytest.mark.parametrize(
    ("wake_mg", "step_mg", "is_motion"), [(31, 58, False), (31, 68, True), (5000, 960, False)]
)
def test_the_motion_detector_of_an_lsm6dsv_has_the_same_threshold_at_each_range(
    range_g, wake_mg, step_mg, is_motion
):
    """Half a step above the threshold, which has 6 bits of 7.8 mg, sets the flag until it is read."""
    t = np.array([0.0, 1.0, 1.001, 3.0])
    force = np.zeros((4, 3))
    force[2:, 0] = step_mg * 1e-3 * STANDARD_GRAVITY
    force[:, 2] = STANDARD_GRAVITY
    motion = RecordedMotion(t, np.zeros((4, 3)), force, temperature_c=25.0, start=0.0)
    part = load_silicon("lsm6dsv")(motion, Specimen(strict=True))
    chip = load("LSM6DSV")(EmulatedBus(part, call_us=0), odr_hz=30, range_g=range_g, wake_mg=wake_mg)
    register, bit = chip.MOTION_FLAG
    PORT_TICKS.now_us += 900_000
    assert not chip.read(register) & bit
    PORT_TICKS.now_us += 900_000
    assert bool(chip.read(register) & bit) == is_motion
    assert bool(part.interrupt_level(PORT_TICKS.now_us * 1e-6)) is False


def test_a_bmi270_gets_its_configuration_completely_and_refuses_another_one(configuration):
    silicon = Bmi270(StillMotion(), Specimen(strict=True))
    driver = load("BMI270")
    driver(EmulatedBus(silicon))
    assert bytes(silicon.configuration) == configuration.read_bytes()
    for content, message in ((bytes(8192), "not accepted"), (b"\xc8\x2e", "has not 8192 bytes")):
        configuration.write_bytes(content)
        with pytest.raises(OSError, match=message):
            driver(EmulatedBus(Bmi270(StillMotion())))
    configuration.unlink()
    with pytest.raises(OSError, match=r"bmi270\.bin"):
        driver(EmulatedBus(Bmi270(StillMotion())))
