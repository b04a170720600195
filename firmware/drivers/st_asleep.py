"""Functions and settings of `parking` for the chips of ST; a module of its own, as it costs heap."""

from micropython import const

_CTRL1_XL = const(0x10)
_CTRL2_G = const(0x11)
_CTRL6_C = const(0x15)
_CTRL7_G = const(0x16)
_CTRL3 = const(0x22)  # register CTRL_REG3 of a LIS3MDL
_POWER_DOWN = const(0x03)
_FIFO_STATUS1 = const(0x3A)
_MD1_CFG = const(0x5E)
_FIFO_DATA_OUT_TAG = const(0x78)

_LOW_POWER_ACCEL = const(0x10)
_LOW_POWER_GYRO = const(0x80)
_OVERRUN = const(0x40)
_FIFO_WORDS = const(4096)
_TAGGED_WORD = const(7)
_TAG_TIMESTAMP = const(4)

_ASLEEP = ((_CTRL6_C, _LOW_POWER_ACCEL), (_CTRL7_G, _LOW_POWER_GYRO))
_AWAKE = ((_CTRL6_C, 0), (_CTRL7_G, 0), (_MD1_CFG, 0))


def parking_settings(chip):
    """Return the settings of the low-power modes, and those that end them and the interrupt of `wake_mg`.

    An LSM6DSV, which has its range in CTRL6, sleeps in high performance; any setting replaces the reset.
    """
    if _fifo_status(chip) == _FIFO_STATUS1:
        return _ASLEEP, _AWAKE
    return _AWAKE[1:2], _AWAKE[1:]


def _fifo_status(chip):
    """Return the first register with the level of the FIFO."""
    return chip.FIFO_STATUS if chip.IS_TAGGED else _FIFO_STATUS1


def halt(chip):
    """Stop sampling; the FIFO keeps its samples."""
    chip.write(_CTRL2_G, 0)
    chip.write(_CTRL1_XL, 0)


def halt_magnetometer(mag):
    """Power a LIS3MDL down to 1 µA, until `configure`."""
    mag.write(_CTRL3, _POWER_DOWN)


def recover_fifo(chip):
    """Return the whole samples in a FIFO that may have overwritten its oldest words."""
    status = bytearray(2)
    chip.i2c.readfrom_mem_into(chip.address, _fifo_status(chip), status)
    if not status[1] & _OVERRUN:
        return chip.fifo_level()
    return _recover_tagged(chip, status) if chip.IS_TAGGED else chip.realign(_FIFO_WORDS)


def _recover_tagged(chip, status):
    """Discard words up to a time stamp, the last word of a sample."""
    words, word = status[0] | (status[1] & 0x03) << 8, bytearray(_TAGGED_WORD)
    for _ in range(3):
        chip.i2c.readfrom_mem_into(chip.address, _FIFO_DATA_OUT_TAG, word)
        words -= 1
        if word[0] >> 3 == _TAG_TIMESTAMP:
            break
    chip.forget_counters()
    return words // 3
