"""What the drivers share: registers on I2C, an id, settings that have to stand, tables of what can be set."""

import time


def nearest(table, wanted):
    """The row of a table whose first number is nearest to what is wanted."""
    best = table[0]
    for row in table:
        if abs(row[0] - wanted) < abs(best[0] - wanted):
            best = row
    return best


def setting(table, value):
    """The row that begins with value. Raises ValueError."""
    row = nearest(table, value)
    if row[0] != value:
        raise ValueError("{} begins no row of {}".format(value, table))
    return row


class Chip:
    """A chip that answers at an address with its WHO_AM_I.

    A driver gives `_settings`, ((register, value), ..) in the order of their writing, and `_standing`, those
    that can be read back; RESET: (register, bit, us to wait between looks whether it is over).
    Raises OSError when the chip is absent or, unless ANY_WHO_AM_I, another one.
    """

    WHO_AM_I_REGISTER = 0x0F
    WHO_AM_I: tuple
    ANY_WHO_AM_I = False
    """Whether another id at this address is taken for a variant, rather than refused."""
    RESET: tuple = ()
    uses_fifo = False
    _settings: tuple
    _standing: tuple

    def __init__(self, i2c, address):
        self.i2c = i2c
        self.address = address
        self._byte = bytearray(1)
        self.who_am_i = self.read(self.WHO_AM_I_REGISTER)
        if not self.ANY_WHO_AM_I and self.who_am_i not in self.WHO_AM_I:
            raise OSError("WHO_AM_I 0x{:02x}: another chip".format(self.who_am_i))

    def configure(self):
        """Resets the chip and writes every setting; sampling starts."""
        if self.RESET:
            register, bit, wait_us = self.RESET
            self._write(register, bit)
            for _ in range(20):
                time.sleep_us(wait_us)
                if not self.read(register) & bit:
                    break
            else:
                raise OSError("reset does not end")
        for register, value in self._settings:
            self._write(register, value)
        if self.uses_fifo:
            self.fifo_flush()  # type: ignore[attr-defined]

    def also(self, settings):
        """Configures the chip anew with more settings that can be read back."""
        self._settings += settings
        self._standing += settings
        self.configure()

    def intact(self):
        """Whether id and settings still stand in the chip: a dip of its supply resets them."""
        for register, value in self._standing:
            if self.read(register) != value:
                return False
        return True

    def read(self, register):
        self.i2c.readfrom_mem_into(self.address, register, self._byte)
        return self._byte[0]

    def _write(self, register, value):
        self._byte[0] = value
        self.i2c.writeto_mem(self.address, register, self._byte)
