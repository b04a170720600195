"""The drivers in the order of the search, and the search; loaded while it runs, as its names cost heap."""

from drivers.chip import acknowledges, nearest, read_register
from wire import (
    FAULT_IMU_MISSING,
    FAULT_IMU_SILENT,
    FAULT_POLLED_TOO_FAST,
    FAULT_WRONG_WHO_AM_I,
    RESET_CAUSE_BROWN_OUT,
    RESET_CAUSE_HARD,
    RESET_CAUSE_POWER_ON,
    RESET_CAUSE_UNKNOWN,
)

IMU_DRIVERS = (
    ("drivers.lsm6ds33", "LSM6DS33", (0x6B, 0x6A), 0x0F, (0x69,)),
    ("drivers.lsm6dso", "LSM6DSO", (0x6B, 0x6A), 0x0F, (0x6C,)),
    ("drivers.lsm6dso", "LSM6DSR", (0x6B, 0x6A), 0x0F, (0x6B,)),
    ("drivers.lsm6dsv", "LSM6DSV", (0x6B, 0x6A), 0x0F, (0x70, 0x73)),
    ("drivers.icm42688", "ICM42688", (0x68, 0x69), 0x75, (0x47,)),
    ("drivers.icm20948", "ICM20948", (0x68, 0x69), 0x00, (0xEA,)),
    ("drivers.bmi270", "BMI270", (0x68, 0x69), 0x00, (0x24,)),
    ("drivers.bmi088", "BMI088", (0x68, 0x69), 0x00, (0x0F,)),
    ("drivers.mpu9250", "MPU9250", (0x68, 0x69), 0x75, (0x70, 0x71, 0x73)),
    ("drivers.mpu6050", "MPU6050", (0x68, 0x69), 0x75, ()),
)
"""(module, class, I2C addresses, WHO_AM_I register, its values); no values: `probe` of the class decides.

A module is loaded when its chip answers. MPU6050 accepts clones with any WHO_AM_I: other chips at its
addresses come before it.
"""

MAG_DRIVERS = (
    ("drivers.lis3mdl", "LIS3MDL", (0x1E, 0x1C), 0x0F, (0x3D,)),
    ("drivers.qmc5883l", "QMC5883L", (0x0D,), 0x0D, (0xFF,)),
    ("drivers.mmc5983ma", "MMC5983MA", (0x30,), 0x2F, (0x30,)),
    ("drivers.akm", "AK09916", (0x0C,), 0x01, (0x09,)),
    ("drivers.akm", "AK8963", (0x0C,), 0x00, (0x48,)),
)

_WITHOUT_POWER = (RESET_CAUSE_UNKNOWN, RESET_CAUSE_POWER_ON, RESET_CAUSE_BROWN_OUT)


def open_chips(parts, board, too_fast):
    """Search for an IMU and a magnetometer, configure them and store them in `parts`, with their faults.

    too_fast: polling has failed, so that samples must come through the FIFO.
    """
    i2c, s = board.i2c, board.settings
    parts.chips = []
    parts.chip = parts.mag = None
    parts.faults &= ~(FAULT_IMU_MISSING | FAULT_WRONG_WHO_AM_I | FAULT_IMU_SILENT)
    if "imu_csn" in s["pins"]:
        from drivers.spi_bus import open_spi_bus, search_spi

        bus = open_spi_bus(board)
        imu = search_spi(bus, parts.chips)
    else:
        bus = i2c
        imu = search(i2c, IMU_DRIVERS, parts.chips)
    if imu is None:
        parts.faults |= FAULT_WRONG_WHO_AM_I if parts.chips else FAULT_IMU_MISSING
    else:
        _open_imu(parts, board, bus, imu, s["fifo"] or s["link"] in "udp ble" or too_fast)
    mag = search(i2c, MAG_DRIVERS, parts.chips)
    if mag is not None:
        driver, address, who_am_i = mag
        part, rate_hz = 0, s["mag_rate_hz"]
        try:
            if rate_hz:
                parts.mag = driver(i2c, address, odr_hz=nearest(driver.RATES_HZ, rate_hz)[0])
                part = driver.PART
        except OSError:
            parts.i2c_errors += 1
        parts.chips.append((address, who_am_i, part))


def _open_imu(parts, board, bus, imu, wants_fifo):
    """Configure the detected IMU with the rate and ranges of its tables that are nearest to the settings."""
    driver, address, who_am_i = imu
    s = board.settings
    try:
        chip = driver(
            bus,
            address,
            odr_hz=nearest(driver.RATES_HZ, s["rate_hz"])[0],
            range_dps=nearest(driver.RANGES_DPS, s["gyro_range_dps"])[0],
            range_g=nearest(driver.RANGES_G, s["accel_range_g"])[0],
            fifo=wants_fifo,
        )
    except OSError:
        parts.i2c_errors += 1
        parts.faults |= FAULT_IMU_MISSING
        parts.chips.append((address, who_am_i, 0))
        return
    parts.chip = chip
    if chip.uses_fifo and not wants_fifo:
        parts.faults |= FAULT_POLLED_TOO_FAST
    parts.chips.append((address, who_am_i, chip.PART))
    if parts.was_running is None:
        parts.was_running = chip.was_running
        if chip.was_running and board.reset_cause in _WITHOUT_POWER:
            # An IMU that is still configured was not without power: the board restarted alone.
            board.reset_cause = RESET_CAUSE_HARD


def search(i2c, drivers, chips):
    """Return (driver, address, WHO_AM_I) of the first chip that a driver recognises, else None.

    Every other chip that acknowledges at one of the addresses is added to `chips` with Part 0.
    """
    chosen = None
    for module, name, addresses, register, identities in drivers:
        for address in addresses:
            if (chosen is not None and chosen[1] == address) or not acknowledges(i2c, address):
                continue
            who_am_i = read_register(i2c, address, register)
            driver, is_known = None, False
            if who_am_i in identities or not identities:
                driver = getattr(__import__(module, None, None, (name,)), name)
                is_known = driver.probe(i2c, address) >= 0
            for row in chips:
                if row[0] == address:
                    # An earlier driver did not recognise this chip and added it with Part 0.
                    chips.remove(row)
                    break
            if chosen is None and is_known:
                chosen = (driver, address, who_am_i)
            else:
                chips.append((address, who_am_i, 0))
    return chosen
