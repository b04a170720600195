"""Base class of the drivers: registers on I2C, a WHO_AM_I, settings that must persist, tables of choices."""

import time

_BYTE = bytearray(1)


def nearest(table, wanted):
    """Return the row of a table whose first number is nearest to `wanted`."""
    best = table[0]
    for row in table:
        if abs(row[0] - wanted) < abs(best[0] - wanted):
            best = row
    return best


def find_setting(table, value):
    """Return the row that begins with `value`. Raises ValueError where there is none."""
    row = nearest(table, value)
    if row[0] != value:
        raise ValueError("{} begins no row of {}".format(value, table))
    return row


def acknowledges(i2c, address):
    """Return True when a chip acknowledges; its register pointer is set to 0, no register is touched."""
    try:
        i2c.writeto(address, b"\0")
    except OSError:
        return False
    return True


def read_register(i2c, address, register):
    """Return the byte in a register of the chip at `address`, or -1 where no chip acknowledges."""
    try:
        i2c.readfrom_mem_into(address, register, _BYTE)
    except OSError:
        return -1
    return _BYTE[0]


class Chip:
    """A chip at an I2C address that identifies itself by WHO_AM_I.

    A driver sets `_settings`, ((register, value), ..) in the order in which they are written, and
    `_standing`, those that can be read back; RESET: (register, bit, us between polls until it is over).
    Raises OSError when `probe` does not recognise the chip.
    """

    WHO_AM_I_REGISTER = 0x0F
    WHO_AM_I: tuple
    RESET: tuple = ()
    MOTION_FLAG: tuple = ()
    """(register, bit) of the chip's motion detector, which reading clears; () where it has none."""
    uses_fifo = False
    _settings: tuple
    _standing: tuple

    @classmethod
    def probe(cls, i2c, address):
        """Return the WHO_AM_I of the chip at `address` if this driver serves it, else -1; only reads."""
        who_am_i = read_register(i2c, address, cls.WHO_AM_I_REGISTER)
        return who_am_i if who_am_i in cls.WHO_AM_I else -1

    def __init__(self, i2c, address):
        self.i2c = i2c
        self.address = address
        self._byte = bytearray(1)
        self.who_am_i = self.probe(i2c, address)
        if self.who_am_i < 0:
            raise OSError("no chip of this driver at 0x{:02x}".format(address))

    def configure(self, *, reset=True):
        """Reset the chip, unless it is to sample on, and write every setting; sampling starts."""
        if reset and self.RESET:
            register, bit, wait_us = self.RESET
            self.write(register, bit)
            for _ in range(20):
                time.sleep_us(wait_us)
                if not self.read(register) & bit:
                    break
            else:
                raise OSError("reset does not end")
        self._after_reset()
        for register, value in self._settings:
            self.write(register, value)
        if self.uses_fifo:
            self.fifo_flush()  # type: ignore[attr-defined]

    def _after_reset(self):
        """Prepare a chip that needs more than settings."""

    def intact(self):
        """Return True while WHO_AM_I and settings persist in the chip: a supply dip resets them."""
        return self._holds(self._standing)

    def _holds(self, settings):
        """Return True if each register of ((register, value), ..) has its value."""
        for register, value in settings:
            if self.read(register) != value:
                return False
        return True

    def shape(self, batch):
        """Set the number of samples of a burst, where the driver needs a buffer for them."""

    def read(self, register):
        """Return the byte in a register."""
        self.i2c.readfrom_mem_into(self.address, register, self._byte)
        return self._byte[0]

    def write(self, register, value):
        self._byte[0] = value
        self.i2c.writeto_mem(self.address, register, self._byte)
