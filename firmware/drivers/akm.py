"""AK8963 and AK09916: the magnetometers inside MPU-9250 and ICM-20948, in the axes of gyro and accelerometer.

chip = AK09916(i2c, odr_hz=10)
words = array("h", bytes(6))
if chip.read_into(words, 0):
    print(words)  # x, y, z in steps of chip.lsb_ft femtotesla

They answer once the IMU connects its inner bus to the outer one, which the drivers of both IMUs request.
"""

import time

from micropython import const

from drivers.chip import Chip, find_setting

_NEW = const(0x01)
_OVERFLOW = const(0x08)
_RESET = const(0x01)
_FUSES = const(0x1F)
_SENSITIVITY_X = const(0x10)
_AFTER_MODE_US = const(100)


class AK09916(Chip):
    """Driver of the AK09916. Raises ValueError for a setting outside the tables, OSError without the chip."""

    PART = 0
    RATES_HZ: tuple = ((10, 0x02), (20, 0x04), (50, 0x06), (100, 0x08))
    # (public value, scale in 1e-15 T per step)
    RANGES_GAUSS = ((49, 150000000),)
    WHO_AM_I_REGISTER = 0x01
    WHO_AM_I = (0x09,)
    RESET = (0x32, _RESET, 1000)
    MODE = 0x31
    STATUS = 0x10
    """Register of the flag of a new sample; the field is behind it."""
    LAST = 8
    """Offset from STATUS of the register that ends a sample and has the flag of an overflow."""
    AXES = ((0, 1), (1, -1), (2, -1))
    """Axis of the chip, and sign, of each axis of gyro and accelerometer."""

    def __init__(self, i2c, address=0x0C, *, odr_hz=10, range_gauss=49):
        self.rate_hz, mode = find_setting(self.RATES_HZ, odr_hz)
        self.range_gauss, self.lsb_ft = find_setting(self.RANGES_GAUSS, range_gauss)
        super().__init__(i2c, address)
        self._settings = ((self.MODE, mode),)
        self._standing = ((self.WHO_AM_I_REGISTER, self.who_am_i),) + self._settings
        self._sensitivity = bytearray(b"\x80\x80\x80")
        self._burst = bytearray(self.LAST)
        self.configure()

    def read_into(self, words, at):
        """Read the field x, y, z to words[at]; return 0 if there is no new valid sample, else 1."""
        if not self.read(self.STATUS) & _NEW:
            return 0
        raw = self._burst
        self.i2c.readfrom_mem_into(self.address, self.STATUS + 1, raw)
        if raw[self.LAST - 1] & _OVERFLOW:
            return 0
        i = 0
        for axis, sign in self.AXES:
            value = raw[2 * axis] | raw[2 * axis + 1] << 8
            if value & 0x8000:
                value -= 65536
            words[at + i] = sign * (value * (self._sensitivity[axis] + 128) >> 8)
            i += 1
        return 1


class AK8963(AK09916):
    """Driver of the AK8963, whose samples are corrected for the sensitivity of each axis."""

    RATES_HZ = ((8, 0x12), (100, 0x16))
    WHO_AM_I_REGISTER = 0x00
    WHO_AM_I = (0x48,)
    RESET = (0x0B, _RESET, 1000)
    MODE = 0x0A
    STATUS = 0x02
    LAST = 7
    AXES = ((1, 1), (0, 1), (2, -1))

    def _after_reset(self):
        """Read the factory's sensitivity, which is accessible in a mode of its own."""
        self.write(self.MODE, _FUSES)
        time.sleep_us(_AFTER_MODE_US)
        self.i2c.readfrom_mem_into(self.address, _SENSITIVITY_X, self._sensitivity)
        self.write(self.MODE, 0)
        time.sleep_us(_AFTER_MODE_US)
