"""QMC5883L: magnetometer of many GY-271 boards (QST), which are sold as HMC5883L, too.

chip = QMC5883L(i2c, odr_hz=10, range_gauss=8)
words = array("h", bytes(6))
if chip.read_into(words, 0):
    print(words)  # x, y, z in steps of chip.lsb_ft femtotesla
"""

from buffers import shared
from micropython import const

from drivers.chip import Chip, find_setting

_OUT = const(0x00)
_STATUS = const(0x06)
_CONTROL_1 = const(0x09)
_CONTROL_2 = const(0x0A)
_SET_RESET_PERIOD = const(0x0B)

_DATA_READY = const(0x01)
_CONTINUOUS = const(0x01)
_NO_INTERRUPT = const(0x01)
_RECOMMENDED_PERIOD = const(0x01)


class QMC5883L(Chip):
    """Driver of the QMC5883L. Raises ValueError for a setting outside the tables, OSError without a chip."""

    PART = 0
    RATES_HZ = ((10, 0x00), (50, 0x04), (100, 0x08), (200, 0x0C))
    # (public value, scale in 1e-15 T per step, from 12000 and 3000 steps per gauss; code)
    RANGES_GAUSS = ((2, 8333333, 0x00), (8, 33333333, 0x10))
    WHO_AM_I_REGISTER = 0x0D
    WHO_AM_I = (0xFF,)

    def __init__(self, i2c, address=0x0D, *, odr_hz=10, range_gauss=8):
        self.rate_hz, rate_code = find_setting(self.RATES_HZ, odr_hz)
        self.range_gauss, self.lsb_ft, range_code = find_setting(self.RANGES_GAUSS, range_gauss)
        super().__init__(i2c, address)
        self._standing = ((_CONTROL_1, _CONTINUOUS | rate_code | range_code),)
        first = ((_SET_RESET_PERIOD, _RECOMMENDED_PERIOD), (_CONTROL_2, _NO_INTERRUPT))
        self._settings = first + self._standing
        self._burst, self._words = shared(3)
        self.configure()

    def read_into(self, words, at):
        """Read the field x, y, z to words[at]; return 0 if there is no new sample, else 1."""
        if not self.read(_STATUS) & _DATA_READY:
            return 0
        self.i2c.readfrom_mem_into(self.address, _OUT, self._burst)
        burst = self._words
        words[at] = burst[0]
        words[at + 1] = burst[1]
        words[at + 2] = burst[2]
        return 1
