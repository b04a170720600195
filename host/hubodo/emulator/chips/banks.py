"""An emulated IMU with banks of registers: key of a register is bank << 7 | sub-address."""

from __future__ import annotations

from hubodo.emulator.chips.imu import Imu


class BankedImu(Imu):
    """An IMU whose sub-addresses name other registers in each bank; only the bank register is in all."""

    N_VALUES = 5 << 7
    BANK_SELECT: int
    BANK_SHIFT = 0
    BANK_MASK = 7

    @property
    def bank(self) -> int:
        """Number of the bank that is selected."""
        return self.values[self.BANK_SELECT] >> self.BANK_SHIFT & self.BANK_MASK

    def _key(self, sub_address: int) -> int:
        return sub_address if sub_address == self.BANK_SELECT else self.bank << 7 | sub_address

    def set_pointer(self, sub_address: int) -> None:
        """Receive the sub-address byte, in the bank that is selected."""
        self.pointer = self._key(sub_address & 0x7F)

    def next_register(self, register: int) -> int:
        """Return the next register of a burst, in the bank that is selected."""
        return self._key((register + 1) & 0x7F)
