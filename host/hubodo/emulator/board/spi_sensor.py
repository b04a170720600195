"""An emulated chip on SPI: a selected chip receives a sub-address with the direction, then bytes."""

from __future__ import annotations

from hubodo.emulator.chips.registers import NotAcknowledged, RegisterChip

_READ = 0x80


class SpiSensor:
    """A chip with its chip select, active low; times in s."""

    def __init__(self, chip: RegisterChip, select_pin: int, byte_s: float) -> None:
        """Connect a chip; byte_s: duration of a byte."""
        self.chip, self.select_pin, self._byte_s = chip, select_pin, byte_s
        self.is_selected = False
        self._received = bytearray()
        self._dummy_left = 0

    def select(self, t: float, level: int) -> None:
        """Set the chip select; its rising edge ends a write, and turns a chip that began on I2C to SPI."""
        was_selected, self.is_selected = self.is_selected, not level
        if was_selected and level:
            if self.chip.spi_is_active and self._received and not self._received[0] & _READ:
                self.chip.write(t, bytes(self._received))
            self.chip.spi_is_active = True
        self._received.clear()

    def transfer(self, t: float, data: bytes) -> bytes:
        """Exchange bytes with the selected chip."""
        if not self._received:
            try:
                self.chip.acknowledge(t)
            except NotAcknowledged:
                return bytes(len(data))
            self._dummy_left = self.chip.SPI_DUMMY_BYTES
            if data[0] & _READ:
                self.chip.set_pointer(data[0] & ~_READ)
        n_new = len(data) - (not self._received)
        self._received += data
        if not self.chip.spi_is_active or not self._received[0] & _READ or not n_new:
            return bytes(len(data))
        n_dummy = min(n_new, self._dummy_left)
        self._dummy_left -= n_dummy
        read = self.chip.read(t, n_new - n_dummy, self._byte_s) if n_new > n_dummy else b""
        return bytes(len(data) - len(read)) + read
