"""Emulated chips on a bus that the firmware drivers can use in CPython."""

import random
import time

from drivers.spi_bus import SpiBus

from fakes.fake_port import PORT_TICKS
from hubodo.emulator.board.bus import I2cBus
from hubodo.emulator.board.spi_sensor import SpiSensor


class EmulatedBus:
    """A substitute for machine.I2C over an emulated bus, in the ticks of the fake port.

    stalls: (mean interval in s, longest duration in s) of random delays of the processor.
    """

    def __init__(self, *chips, faults=(), call_us=40, stalls=None, seed=1):
        self.bus = I2cBus(chips, faults)
        self.call_us = call_us
        self.stalls = stalls
        self.stalled_us = 0
        self.zero_us = PORT_TICKS.now_us
        self._rng = random.Random(seed)

    @property
    def t(self):
        """Return the time of the chips in s."""
        return (PORT_TICKS.now_us - self.zero_us) * 1e-6

    def advance_time(self, us):
        """Advance the time, sometimes by more than requested (a stall)."""
        PORT_TICKS.now_us += us
        if self.stalls is None:
            return
        mean, longest = self.stalls
        if self._rng.random() < us * 1e-6 / mean:
            stall_us = self._rng.random() * longest * 1e6
            self.stalled_us += stall_us
            PORT_TICKS.now_us += stall_us

    def _after(self, status, end):
        PORT_TICKS.now_us = max(PORT_TICKS.now_us, self.zero_us + end * 1e6)
        self.advance_time(self.call_us)
        if status < 0:
            raise OSError(-status)

    def readfrom_mem_into(self, address, register, buffer):
        view = memoryview(buffer).cast("B")
        status, data, end = self.bus.read_mem(self.t, address, bytes([register]), len(view))
        if status >= 0:
            view[:] = data
        self._after(status, end)

    def writeto(self, address, buffer):
        status, end = self.bus.write(self.t, address, bytes(buffer))
        self._after(status, end)

    def writeto_mem(self, address, register, buffer):
        status, end = self.bus.write(self.t, address, bytes([register]) + bytes(buffer))
        self._after(status, end)

    def ticks_us(self):
        """Replace `ticks_us` of a firmware module: reading the clock takes 5 µs and may stall."""
        now = time.ticks_us()
        self.advance_time(5)
        return now


class EmulatedSpi:
    """A substitute for machine.SPI and chip select over an emulated chip, in the ticks of the fake port."""

    SELECT_PIN, BYTE_S = 13, 1e-6

    def __init__(self, chip, call_us=5):
        self._sensor = SpiSensor(chip, self.SELECT_PIN, self.BYTE_S)
        self._zero_us, self._call_us = PORT_TICKS.now_us, call_us

    @property
    def t(self):
        """Return the time of the chip in s."""
        return (PORT_TICKS.now_us - self._zero_us) * 1e-6

    def value(self, level):
        self._sensor.select(self.t, level)
        PORT_TICKS.now_us += self._call_us

    def write(self, out):
        self._exchange(bytes(out))

    def readinto(self, into, write=0):
        view = memoryview(into).cast("B")
        view[:] = self._exchange(bytes([write]) * len(view))

    def _exchange(self, out):
        received = self._sensor.transfer(self.t, out)
        PORT_TICKS.now_us += self._call_us + len(out) * self.BYTE_S * 1e6
        return received


def spi_bus(chip, **options):
    """Return the firmware's bus over an emulated chip on SPI."""
    spi = EmulatedSpi(chip, **options)
    bus = SpiBus(spi, spi, chip.SPI_DUMMY_BYTES)
    # As the search does: a chip may begin on I2C.
    bus.readfrom_mem_into(0, chip.identity_register, bytearray(1))
    return bus
