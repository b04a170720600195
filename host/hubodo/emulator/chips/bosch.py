"""Base of the emulated Bosch chips: bursts hold one sample, and the FIFO is read through one register."""

from __future__ import annotations

from hubodo.emulator.chips.registers import RegisterChip

_NO_DATA = 0x80


class BoschChip(RegisterChip):
    """A chip whose output registers hold one sample for a burst, whatever the transfers of the bus are.

    OUTPUT, OUTPUT_BYTES: first output register, and their number; FIFO_REGISTER: the burst does not leave it.
    """

    OUTPUT: int
    OUTPUT_BYTES: int
    FIFO_REGISTER: int

    def power_on(self, t: float) -> None:
        """Reset the registers at t, as power-up and soft reset do."""
        super().power_on(t)
        self._sample, self._data_ready = bytes(self.OUTPUT_BYTES), 0
        self._held_sample: bytes | None = None
        self._fifo = bytearray()

    def measure_until(self, t: float) -> None:
        """Measure the samples due by t, and store them in the FIFO."""
        raise NotImplementedError

    def set_pointer(self, sub_address: int) -> None:
        """Receive the sub-address byte, with which a burst begins."""
        super().set_pointer(sub_address)
        self._held_sample = None

    def next_register(self, register: int) -> int:
        """Return the next register of a burst; that of the FIFO repeats."""
        return register if register == self.FIFO_REGISTER else (register + 1) & 0x7F

    def read(self, t: float, n: int, byte_time: float) -> bytes:
        """Return a burst, or the next part of one."""
        self.measure_until(t)
        if self.pointer == self.FIFO_REGISTER:
            data = self.read_fifo(n)
            if len(data) < n:
                self.anomalies["read of empty FIFO"] += 1
            return data + bytes([_NO_DATA]) * (n - len(data))
        start = self.pointer - self.OUTPUT
        if not 0 <= start <= self.OUTPUT_BYTES - n:
            return super().read(t, n, byte_time)
        if self._held_sample is None:
            self._held_sample = self._sample
        self._data_ready = 0
        self.pointer += n
        return self._held_sample[start : start + n]

    def read_fifo(self, n: int) -> bytes:
        """Return up to n bytes of the FIFO, and remove them."""
        data = bytes(self._fifo[:n])
        del self._fifo[:n]
        return data
