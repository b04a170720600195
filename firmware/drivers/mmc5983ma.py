"""MMC5983MA: magnetometer that cancels its offset by magnetic set and reset (Memsic).

chip = MMC5983MA(i2c, odr_hz=10)
words = array("h", bytes(6))
if chip.read_into(words, 0):
    print(words)  # x, y, z in steps of chip.lsb_ft femtotesla
"""

from micropython import const

from drivers.chip import Chip, find_setting

_OUT = const(0x00)
_STATUS = const(0x08)
_CONTROL_0 = const(0x09)
_CONTROL_1 = const(0x0A)
_CONTROL_2 = const(0x0B)

_DONE = const(0x01)
_AUTO_SET_RESET = const(0x20)
_SW_RESET = const(0x80)
# Continuous, with a set after each 25 measurements: it restores the sensitivity after a magnet came close.
_CONTINUOUS = const(0x98)
_ZERO = const(32768)


class MMC5983MA(Chip):
    """Driver of the MMC5983MA. Raises ValueError for a setting outside the tables, OSError without the chip.

    Its settings cannot be read back: `intact` compares the identity alone.
    """

    PART = 0
    # (public value, code of the rate, code of the bandwidth)
    RATES_HZ = ((10, 2, 0), (20, 3, 0), (50, 4, 0), (100, 5, 0), (200, 6, 1))
    # (public value, scale in 1e-15 T per step, from 4096 steps per gauss)
    RANGES_GAUSS = ((8, 24414062),)
    RESET = (_CONTROL_1, _SW_RESET, 10000)
    WHO_AM_I_REGISTER = 0x2F
    WHO_AM_I = (0x30,)

    def __init__(self, i2c, address=0x30, *, odr_hz=10, range_gauss=8):
        self.rate_hz, rate_code, bandwidth_code = find_setting(self.RATES_HZ, odr_hz)
        self.range_gauss, self.lsb_ft = find_setting(self.RANGES_GAUSS, range_gauss)
        super().__init__(i2c, address)
        self._standing = ((self.WHO_AM_I_REGISTER, self.who_am_i),)
        self._settings = (
            (_CONTROL_0, _AUTO_SET_RESET),
            (_CONTROL_1, bandwidth_code),
            (_CONTROL_2, _CONTINUOUS | rate_code),
        )
        self._burst = bytearray(6)
        self.configure()

    def read_into(self, words, at):
        """Read the field x, y, z to words[at]; return 0 if there is no new sample, else 1."""
        if not self.read(_STATUS) & _DONE:
            return 0
        burst = self._burst
        self.i2c.readfrom_mem_into(self.address, _OUT, burst)
        self.write(_STATUS, _DONE)
        for i in range(3):
            words[at + i] = (burst[2 * i] << 8 | burst[2 * i + 1]) - _ZERO
        return 1
