"""Base class of the six-axis chips of ST with a tagged FIFO: LSM6DSO, LSM6DSR, LSM6DSV and their variants.

Each word of the FIFO has a tag: its sensor, and a counter of two bits that advances with each sample. At most
rates the chip's time stamp is stored with each sample; above, the bus has no time for it.
"""

from micropython import const

from drivers.st_imu import StImu

_FIFO_CTRL4 = const(0x0A)
_WHO_AM_I = const(0x0F)
_CTRL2_G = const(0x11)
_CTRL3_C = const(0x12)
_FIFO_DATA_OUT_TAG = const(0x78)

_SW_RESET = const(0x01)
_BYPASS = const(0)
_CONTINUOUS = const(0x06)
_TIMESTAMP_EVERY = const(0x40)
_OVERRUN = const(0x40)
_NEAR_CARRY = const(250)
_WORD = const(7)
_TAG_GYRO = const(1)
_TAG_ACCEL = const(2)
_TAG_TIMESTAMP = const(4)


class TaggedImu(StImu):
    """Reads the FIFO; a subclass adds settings. has_stamps: the FIFO stores time stamps, too.

    A subclass sets FIFO_STATUS, the first register with the level; FIFO_WORDS, the capacity;
    TICKS_PER_KS, the advance of the time stamp in 1000 s; RATE_TRIM, (register, step in 1e-4) of the rate
    that the factory measured.
    """

    PART = 0
    IS_TAGGED = True
    RESET = (_CTRL3_C, _SW_RESET, 100)
    FIFO_STATUS: int
    FIFO_WORDS: int
    TICKS_PER_KS: int
    RATE_TRIM: tuple

    def __init__(self, i2c, address, rate_mhz, has_stamps):
        super().__init__(i2c, address)
        self.temperature_lsb_udegc = 3906
        self.temperature_offset_udegc = 25000000
        self.was_running = self.read(_CTRL2_G) != 0
        """True if the gyro was already running: after power-on it is off, so the chip has kept its power."""
        self._words = 3 if has_stamps else 2
        self.FIFO_SAMPLES = self.FIFO_WORDS // self._words
        """Capacity of the FIFO in whole samples."""
        register, step = self.RATE_TRIM
        trim = self.read(register)
        self.rate_mhz = rate_mhz * (10000 + step * (trim - 256 if trim & 0x80 else trim)) // 10000
        self._overdue = 3 * self.TICKS_PER_KS // (2 * rate_mhz)
        """Ticks of the chip between two samples that show that one is missing: one period and a half."""
        self._fifo_on = _CONTINUOUS | (_TIMESTAMP_EVERY if has_stamps else 0)
        self._level = memoryview(self._status)[:2]
        self._count = self._ticks = -1
        self.shape(1)

    def start(self, settings, *, reset):
        """Write the settings of the subclass; sampling starts."""
        self._settings = settings
        fifo_mode = self._fifo_on if self.uses_fifo else 0
        self._standing = ((_WHO_AM_I, self.who_am_i), (_FIFO_CTRL4, fifo_mode)) + settings
        self.configure(reset=reset)

    def shape(self, batch):
        """Set the number of samples that `fifo_read_into` reads."""
        self._raw = bytearray(batch * self._words * _WORD)

    def fifo_level(self):
        """Return the number of whole samples in the FIFO; -1 if it has overflowed."""
        status, last = self._level, -1
        self.i2c.readfrom_mem_into(self.address, self.FIFO_STATUS, status)
        # A word between the two bytes makes the level 256 too large: read until two readings agree.
        while status[0] >= _NEAR_CARRY and (status[1] << 8 | status[0]) != last:
            last = status[1] << 8 | status[0]
            self.i2c.readfrom_mem_into(self.address, self.FIFO_STATUS, status)
        if status[1] & _OVERRUN:
            return -1
        return (status[0] | (status[1] & 0x03) << 8) // self._words

    def fifo_read_into(self, rows):
        """Read len(rows) / 12 samples in one burst, in the order of the wire.

        Return True if words are missing between them, by their counters and the chip's time stamps.
        """
        raw, size = self._raw, _WORD * self._words
        self.i2c.readfrom_mem_into(self.address, _FIFO_DATA_OUT_TAG, raw)
        at, torn = 0, False
        for to in range(0, len(rows), 12):
            count = raw[at] & 0x06
            if self._count >= 0 and count != (self._count + 2) & 0x06:
                torn = True
            self._count = count
            end = at + size
            while at < end:
                kind = raw[at] >> 3
                if raw[at] & 0x06 != count:
                    torn = True
                if kind == _TAG_GYRO or kind == _TAG_ACCEL:
                    first = to if kind == _TAG_GYRO else to + 6
                    for i in range(6):
                        rows[first + i] = raw[at + 1 + i]
                elif kind == _TAG_TIMESTAMP:
                    ticks = raw[at + 1] | raw[at + 2] << 8
                    if self._ticks >= 0 and (ticks - self._ticks) & 0xFFFF > self._overdue:
                        torn = True
                    self._ticks = ticks
                else:
                    torn = True
                at += _WORD
        return torn

    def forget_counters(self):
        """Accept any counter and time stamp with the next sample."""
        self._count = self._ticks = -1

    def fifo_flush(self):
        """Flush the FIFO and restart it at a whole sample."""
        self.forget_counters()
        self.write(_FIFO_CTRL4, _BYPASS)
        self.write(_FIFO_CTRL4, self._fifo_on)
