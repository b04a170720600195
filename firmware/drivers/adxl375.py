"""ADXL375: accelerometer of +-200 g beside the IMU, with a FIFO of 32 samples (Analog Devices).

chip = ADXL375(i2c, odr_hz=400)
sample = bytearray(6)
for _ in range(chip.level()):
    chip.read_into(sample, 0)  # x, y, z: int16, little-endian, in steps of chip.LSB_NG
"""

from micropython import const

from drivers.chip import Chip, find_setting

_DEVID = const(0x00)
_BW_RATE = const(0x2C)
_POWER_CTL = const(0x2D)
_INT_ENABLE = const(0x2E)
_DATA_FORMAT = const(0x31)
_DATAX0 = const(0x32)
_FIFO_CTL = const(0x38)
_FIFO_STATUS = const(0x39)

_MEASURE = const(0x08)
_RIGHT_JUSTIFIED = const(0x0B)
_STREAM = const(0x80)
_ENTRIES = const(0x3F)
_SAMPLE = const(6)


class ADXL375(Chip):
    """Driver of the ADXL375. Raises ValueError for a rate outside the table, OSError without the chip.

    An ADXL345, of 16 g, has the same identity: the host compares both accelerometers.
    """

    RATES_HZ = ((100, 0x0A), (200, 0x0B), (400, 0x0C))
    LSB_NG = 49000000
    WHO_AM_I_REGISTER = _DEVID
    WHO_AM_I = (0xE5,)

    def __init__(self, i2c, address=0x53, *, odr_hz=400):
        self.rate_hz, rate_code = find_setting(self.RATES_HZ, odr_hz)
        super().__init__(i2c, address)
        self._standing = (
            (_BW_RATE, rate_code),
            (_DATA_FORMAT, _RIGHT_JUSTIFIED),
            (_FIFO_CTL, _STREAM),
            (_INT_ENABLE, 0),
            (_POWER_CTL, _MEASURE),
        )
        self._settings = ((_POWER_CTL, 0),) + self._standing
        self._sample = bytearray(_SAMPLE)
        self.configure()

    def level(self):
        """Return the number of samples that wait; from 32 on some may be lost."""
        return self.read(_FIFO_STATUS) & _ENTRIES

    def read_into(self, raw, at):
        """Read the oldest sample to six bytes of `raw` from `at` on."""
        sample = self._sample
        # One transfer for a sample: its end moves the FIFO on.
        self.i2c.readfrom_mem_into(self.address, _DATAX0, sample)
        for i in range(_SAMPLE):
            raw[at + i] = sample[i]
