"""An IMU on SPI behind the methods of machine.I2C that drivers use; loaded where `pins` has its select."""

from micropython import const

from drivers.chip import read_register

_SPI_HZ = const(8000000)
_READ = const(0x80)

SPI_DRIVERS = (
    ("drivers.icm42688", "ICM42688Spi", 0, 0x75, (0x47,)),
    ("drivers.bmi270", "BMI270", 1, 0x00, (0x24,)),
)
"""(module, class, bytes before the first one of a read, WHO_AM_I register, its values)."""


class SpiBus:
    """The bus of one chip; the addresses of I2C are ignored, and a chip that is absent reads as 0 or 255.

    dummy: bytes that the chip sends before the first one of a read.
    """

    def __init__(self, spi, select, dummy=0):
        self._spi, self._select = spi, select
        self._register = bytearray(1)
        self.set_dummy(dummy)

    def set_dummy(self, dummy):
        self._dummy = bytearray(dummy)

    def readfrom_mem_into(self, address, register, buffer):
        """Read consecutive registers, as many as fit in the buffer."""
        self._register[0] = register | _READ
        self._select.value(0)
        self._spi.write(self._register)
        if self._dummy:
            self._spi.readinto(self._dummy)
        self._spi.readinto(buffer)
        self._select.value(1)

    def writeto_mem(self, address, register, buffer):
        """Write consecutive registers."""
        self._register[0] = register
        self._select.value(0)
        self._spi.write(self._register)
        self._spi.write(buffer)
        self._select.value(1)


def open_spi_bus(board):
    """Return the bus of the IMU on the pins of a board, which it may share with a radio."""
    from machine import SPI, Pin

    pins = board.pins
    spi = SPI(
        pins["spi"],
        baudrate=_SPI_HZ,
        sck=Pin(pins["sck"]),
        mosi=Pin(pins["mosi"]),
        miso=Pin(pins["miso"]),
    )
    return SpiBus(spi, Pin(pins["imu_csn"], Pin.OUT, value=1))


def search_spi(bus, chips):
    """Return (driver, 0, WHO_AM_I) of the chip on the bus if a driver serves it, else None.

    Another chip that answers is added to `chips`. The address 0 stands for SPI.
    """
    other = 0
    for module, name, dummy, register, identities in SPI_DRIVERS:
        bus.set_dummy(dummy)
        # Some chips begin on I2C and turn to SPI with the first selection.
        read_register(bus, 0, register)
        who_am_i = read_register(bus, 0, register)
        if who_am_i in identities:
            return getattr(__import__(module, None, None, (name,)), name), 0, who_am_i
        if not 0 < other < 0xFF:
            other = who_am_i
    if 0 < other < 0xFF:
        chips.append((0, other, 0))
    return None
