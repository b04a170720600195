"""MPU-6050 and its clones: gyro and accelerometer (InvenSense).

chip = MPU6050(i2c, odr_hz=200, range_dps=2000, range_g=16)
words = array("h", bytes(12))
if chip.read_into(words, 0):
    print(words)  # gyro x, y, z, acceleration x, y, z in steps of chip.gyro_lsb_ndps, chip.accel_lsb_ng
"""

from micropython import const
from wire import PART_MPU6050

from drivers.chip import Chip, find_setting, read_register

_SMPLRT_DIV = const(0x19)
_CONFIG = const(0x1A)
_GYRO_CONFIG = const(0x1B)
_ACCEL_CONFIG = const(0x1C)
_FIFO_EN = const(0x23)
_INT_ENABLE = const(0x38)
_INT_STATUS = const(0x3A)
_TEMP_OUT = const(0x41)
_USER_CTRL = const(0x6A)
_PWR_MGMT_1 = const(0x6B)
_FIFO_COUNT = const(0x72)
_FIFO_R_W = const(0x74)
_WHO_AM_I = const(0x75)

_DEVICE_RESET = const(0x80)
_CLOCK_OF_GYRO = const(0x01)
_PWR_MGMT_1_VALUES = (0x40, 0x01)
"""After power-on: MPU-6050 (asleep), MPU-6500; the second also once `configure` has run."""
_DATA_READY = const(0x01)
_FIFO_OVERFLOW = const(0x10)
_GYRO_AND_ACCEL = const(0x78)
_FIFO_ON = const(0x40)
_FIFO_RESET = const(0x04)
_SAMPLE = const(12)
_WHO_AM_I_OF_OTHERS = (0x47, 0x70, 0x71, 0x73)
"""ICM-42688-P, MPU-6500, MPU-9250 and MPU-9255, which have drivers of their own."""
_OTHER_CHIPS = (0x24, 0xEA, 0x0F)
"""Register 0 of a BMI270, an ICM-20948 and a BMI088, where they have their identity."""


class MPU6050(Chip):
    """Driver of the MPU-6050. fifo: use the FIFO at 250 Hz and below, too; above, always. wake_mg: ignored.

    Raises ValueError for a setting outside the tables, OSError when nothing answers.

    Chips sold as MPU-6050 have many WHO_AM_I: `probe` accepts an unknown one where PWR_MGMT_1 reads as after
    power-on or as configured here. PART is then 0, and Hello carries the WHO_AM_I.
    """

    PART = PART_MPU6050
    # (public value, actual rate in mHz, divider of 1 kHz minus 1, code of a low-pass below half the rate)
    RATES_HZ = (
        (50, 50000, 19, 5),
        (100, 100000, 9, 3),
        (125, 125000, 7, 3),
        (200, 200000, 4, 2),
        (250, 250000, 3, 2),
        (500, 500000, 1, 1),
        (1000, 1000000, 0, 1),
    )
    RANGES_DPS = (
        (250, 7633588, 0x00),
        (500, 15267176, 0x08),
        (1000, 30487805, 0x10),
        (2000, 60975610, 0x18),
    )
    RANGES_G = ((2, 61035, 0x00), (4, 122070, 0x08), (8, 244141, 0x10), (16, 488281, 0x18))
    RESET = (_PWR_MGMT_1, _DEVICE_RESET, 10000)
    FIFO_BYTES = 1024
    FIFO_SAMPLES = 85
    """Capacity of the FIFO in whole samples."""
    WHO_AM_I_REGISTER = _WHO_AM_I
    WHO_AM_I = (0x68, 0x72, 0x98)
    CLONES = True
    """True if an unknown WHO_AM_I is accepted where PWR_MGMT_1 has the value of an MPU."""
    TEMPERATURE = (2941, 36530000)
    """Step and offset of the thermometer, 1e-6 degC."""

    @classmethod
    def probe(cls, i2c, address):
        """Return the WHO_AM_I of the chip at `address` if it is an MPU or behaves like one, else -1."""
        who_am_i = read_register(i2c, address, _WHO_AM_I)
        if who_am_i in cls.WHO_AM_I:
            return who_am_i
        if (
            not cls.CLONES
            or who_am_i in _WHO_AM_I_OF_OTHERS
            or read_register(i2c, address, 0) in _OTHER_CHIPS
        ):
            return -1
        return who_am_i if read_register(i2c, address, _PWR_MGMT_1) in _PWR_MGMT_1_VALUES else -1

    def __init__(self, i2c, address=0x68, *, odr_hz=200, range_dps=2000, range_g=16, fifo=False, wake_mg=0):
        odr, self.rate_mhz, divider, low_pass = find_setting(self.RATES_HZ, odr_hz)
        self.range_dps, self.gyro_lsb_ndps, gyro_code = find_setting(self.RANGES_DPS, range_dps)
        self.range_g, self.accel_lsb_ng, accel_code = find_setting(self.RANGES_G, range_g)
        super().__init__(i2c, address)
        self.uses_fifo = fifo or odr > 250
        self.temperature_raw = self.realigned = 0
        self.temperature_lsb_udegc, self.temperature_offset_udegc = self.TEMPERATURE
        if self.who_am_i not in self.WHO_AM_I:
            self.PART = 0
        self._settings = (
            (_PWR_MGMT_1, _CLOCK_OF_GYRO),
            (_SMPLRT_DIV, divider),
            (_CONFIG, low_pass),
            (_GYRO_CONFIG, gyro_code),
            (_ACCEL_CONFIG, accel_code),
            (_FIFO_EN, _GYRO_AND_ACCEL if self.uses_fifo else 0),
            (_INT_ENABLE, _DATA_READY),
        ) + self._more_settings(low_pass)
        user_control = _FIFO_ON if self.uses_fifo else 0
        self._standing = ((_WHO_AM_I, self.who_am_i), (_USER_CTRL, user_control)) + self._settings
        self.was_running = self.read(_INT_ENABLE) != 0
        """True if it was already configured: power-on clears this register."""
        self._burst = bytearray(15)
        self._count = bytearray(2)
        self._ready = 0
        self.configure()

    def _more_settings(self, low_pass):
        """Return the settings of a variant."""
        return ()

    def ready(self):
        """Return True if a new sample is available."""
        # Reading the flag clears it.
        self._ready |= self.read(_INT_STATUS)
        return self._ready & _DATA_READY

    def read_into(self, words, at):
        """Read a sample of six words to words[at] in one burst; return 0 if there is no new one, else 1."""
        raw = self._burst
        self.i2c.readfrom_mem_into(self.address, _INT_STATUS, raw)
        if not (self._ready | raw[0]) & _DATA_READY:
            return 0
        self._ready = 0
        words[at] = _signed(raw[9] << 8 | raw[10])
        words[at + 1] = _signed(raw[11] << 8 | raw[12])
        words[at + 2] = _signed(raw[13] << 8 | raw[14])
        words[at + 3] = _signed(raw[1] << 8 | raw[2])
        words[at + 4] = _signed(raw[3] << 8 | raw[4])
        words[at + 5] = _signed(raw[5] << 8 | raw[6])
        self.temperature_raw = _signed(raw[7] << 8 | raw[8])
        return 1

    def fifo_level(self):
        """Return the number of whole samples in the FIFO; -1 if it has overflowed."""
        count = self._count
        self.i2c.readfrom_mem_into(self.address, _FIFO_COUNT, count)
        size = count[0] << 8 | count[1]
        # The flag is read only when the FIFO is full: another transfer would blur the time of this poll.
        if size > self.FIFO_BYTES - _SAMPLE and self.read(_INT_STATUS) & _FIFO_OVERFLOW:
            return -1
        return size // _SAMPLE

    def fifo_read_into(self, rows):
        """Read len(rows) / 12 whole samples in one burst, reordered to the order of the wire."""
        self.i2c.readfrom_mem_into(self.address, _FIFO_R_W, rows)
        # Big-endian accelerometer, then gyro: each byte is swapped with one of the other triad.
        for i in range(0, len(rows), 12):
            rows[i], rows[i + 7] = rows[i + 7], rows[i]
            rows[i + 1], rows[i + 6] = rows[i + 6], rows[i + 1]
            rows[i + 2], rows[i + 9] = rows[i + 9], rows[i + 2]
            rows[i + 3], rows[i + 8] = rows[i + 8], rows[i + 3]
            rows[i + 4], rows[i + 11] = rows[i + 11], rows[i + 4]
            rows[i + 5], rows[i + 10] = rows[i + 10], rows[i + 5]

    def fifo_flush(self):
        """Flush the FIFO and restart it at a whole sample."""
        self.write(_USER_CTRL, _FIFO_RESET)
        self.write(_USER_CTRL, _FIFO_ON)
        # Reading the flag of an overflow clears it.
        self.read(_INT_STATUS)

    def read_temperature(self):
        """Update `temperature_raw`, which samples in the FIFO do not contain."""
        raw = self._count
        self.i2c.readfrom_mem_into(self.address, _TEMP_OUT, raw)
        self.temperature_raw = _signed(raw[0] << 8 | raw[1])


def _signed(value):
    return value - 65536 if value & 0x8000 else value
