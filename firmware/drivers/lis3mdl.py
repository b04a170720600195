"""LIS3MDL: magnetometer of the MinIMU-9 (ST).

chip = LIS3MDL(i2c, odr_hz=10, range_gauss=4)
words = array("h", bytes(6))
if chip.read_into(words, 0):
    print(words)  # x, y, z in steps of chip.lsb_ft femtotesla
"""

from buffers import shared
from micropython import const
from wire import PART_LIS3MDL

from drivers.chip import Chip, find_setting

_CTRL1 = const(0x20)
_CTRL2 = const(0x21)
_CTRL3 = const(0x22)
_CTRL4 = const(0x23)
_CTRL5 = const(0x24)
_STATUS = const(0x27)
_OUT = const(0x28)
_AUTO_INCREMENT = const(0x80)

_HIGH_PERFORMANCE_XY = const(0x40)
_HIGH_PERFORMANCE_Z = const(0x08)
_CONTINUOUS = const(0x00)
_BDU = const(0x40)
_ZYXDA = const(0x08)


class LIS3MDL(Chip):
    """Driver of the LIS3MDL. Raises ValueError for a setting outside the tables, OSError without the chip."""

    PART = PART_LIS3MDL
    RATES_HZ = ((5, 0x0C), (10, 0x10), (20, 0x14), (40, 0x18), (80, 0x1C))
    # (public value, scale in 1e-15 T per step, from 6842, 3421, 2281, 1711 steps per gauss; code)
    RANGES_GAUSS = ((4, 14615610, 0x00), (8, 29231219, 0x20), (12, 43840421, 0x40), (16, 58445354, 0x60))
    WHO_AM_I = (0x3D,)

    def __init__(self, i2c, address=0x1E, *, odr_hz=10, range_gauss=4):
        self.rate_hz, rate_code = find_setting(self.RATES_HZ, odr_hz)
        self.range_gauss, self.lsb_ft, range_code = find_setting(self.RANGES_GAUSS, range_gauss)
        super().__init__(i2c, address)
        self._settings = self._standing = (
            (_CTRL1, _HIGH_PERFORMANCE_XY | rate_code),
            (_CTRL2, range_code),
            (_CTRL4, _HIGH_PERFORMANCE_Z),
            (_CTRL5, _BDU),
            (_CTRL3, _CONTINUOUS),
        )
        self._burst, self._words = shared(3)
        self.configure()

    def read_into(self, words, at):
        """Read the field x, y, z to words[at]; return 0 if there is no new sample, else 1."""
        # Not in one burst: a sample taken just after the status byte would be read and its flag lost.
        if not self.read(_STATUS) & _ZYXDA:
            return 0
        self.i2c.readfrom_mem_into(self.address, _OUT | _AUTO_INCREMENT, self._burst)
        burst = self._words
        words[at] = burst[0]
        words[at + 1] = burst[1]
        words[at + 2] = burst[2]
        return 1
