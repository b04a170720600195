"""I2C slave with byte-addressed registers behind a sub-address pointer."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from hubodo.emulator.chips.faults import BitFlip, BrownOut, BusNack, ScriptedFault, WrongWhoAmI
from hubodo.errors import HubodoError


class ChipAccessError(HubodoError):
    """A driver read an undocumented register, or wrote an undocumented or read-only one."""


class NotAcknowledged(Exception):
    """The chip did not acknowledge its address."""


@dataclass(frozen=True)
class Register:
    """A row of a register map: name, value at power-on, and mask of the bits that a write changes."""

    name: str
    reset: int = 0
    writable: int = 0


@dataclass(frozen=True)
class RegisterWrite:
    """A register write at t, in s."""

    t: float
    register: int
    value: int


class RegisterChip:
    """Registers, pointer, faults and write log of a chip; a subclass adds the effects of reads and writes.

    Parameters
    ----------
    name : name that `ScriptedFault.chip` refers to, "imu" or "mag".
    address : 7-bit I2C address.
    registers : register map, by sub-address.
    who_am_i : sub-address and value of the identity register.
    faults : faults; those of other chips are ignored.
    strict : raise ChipAccessError where a real chip silently does something undocumented: an unknown register
        reads 0, a read-only or unknown one ignores a write. Both are counted in `anomalies` in any case.
    """

    N_VALUES = 256
    SPI_DUMMY_BYTES = 0
    """Bytes that the chip sends on SPI before the first one of a read."""
    spi_is_active = True
    """False for a chip that turns to SPI when it is deselected for the first time."""
    companions: tuple[RegisterChip, ...] = ()
    """Further chips in the same package, with addresses of their own."""

    def __init__(
        self,
        name: str,
        address: int,
        registers: dict[int, Register],
        who_am_i: tuple[int, int],
        faults: tuple[ScriptedFault, ...] = (),
        *,
        strict: bool = False,
    ) -> None:
        self.name, self.address, self.map, self.strict = name, address, registers, strict
        self.faults = tuple(f for f in faults if getattr(f, "chip", name) == name)
        self._who_am_i = who_am_i
        self._nack_faults = sorted((f for f in self.faults if isinstance(f, BusNack)), key=lambda f: f.t)
        self._bit_faults = sorted(
            (f for f in self.faults if isinstance(f, BitFlip | WrongWhoAmI | BrownOut)), key=lambda f: f.t
        )
        self._pending_nacks = 0
        self._next_fault_time = self._bit_faults[0].t if self._bit_faults else float("inf")
        self.values = bytearray(self.N_VALUES)
        self.pointer = 0
        self.writes: list[RegisterWrite] = []
        self.anomalies: Counter[str] = Counter()
        self.power_on(0.0)

    @property
    def identity_register(self) -> int:
        """Sub-address of the identity register."""
        return self._who_am_i[0]

    def power_on(self, t: float) -> None:
        """Set the registers to their power-on values at t."""
        self.values[:] = bytes(self.N_VALUES)
        for register, definition in self.map.items():
            self.values[register] = definition.reset
        self.values[self._who_am_i[0]] = self._who_am_i[1]
        self.pointer = 0

    def acknowledge(self, t: float) -> None:
        """Receive the address byte at t; raise NotAcknowledged if a fault requires it."""
        if t >= self._next_fault_time:
            self._apply_faults(t)
        while self._nack_faults and self._nack_faults[0].t <= t:
            self._pending_nacks += self._nack_faults.pop(0).count
        if self._pending_nacks:
            self._pending_nacks -= 1
            self.anomalies["nack"] += 1
            raise NotAcknowledged

    def _apply_faults(self, t: float) -> None:
        """Apply the faults of stored bits that are due at t."""
        while self._bit_faults and self._bit_faults[0].t <= t:
            fault = self._bit_faults.pop(0)
            if isinstance(fault, BrownOut):
                self.power_on(fault.t)
            elif isinstance(fault, WrongWhoAmI):
                self._who_am_i = (self._who_am_i[0], fault.value)
                self.values[self._who_am_i[0]] = fault.value
            elif isinstance(fault, BitFlip):
                self.values[fault.register] ^= 1 << fault.bit
                self.on_register_changed(fault.t, fault.register)
        self._next_fault_time = self._bit_faults[0].t if self._bit_faults else float("inf")

    def write(self, t: float, data: bytes) -> None:
        """Receive the bytes after the address byte of a write at t: the sub-address, then values."""
        if not data:
            return
        self.set_pointer(data[0])
        for value in data[1:]:
            self._write_register(t, self.pointer, value)
            self.pointer = self.next_register(self.pointer)

    def set_pointer(self, sub_address: int) -> None:
        """Receive the sub-address byte."""
        self.pointer = sub_address

    def next_register(self, register: int) -> int:
        """Return the register that follows `register` in a burst."""
        return (register + 1) & 0xFF

    def _write_register(self, t: float, register: int, value: int) -> None:
        """Write one register, with its mask."""
        definition = self.map.get(register)
        if definition is None or not definition.writable:
            self._count_anomaly("write", register)
            return
        self.writes.append(RegisterWrite(t, register, value))
        self.values[register] = (self.values[register] & ~definition.writable) | (value & definition.writable)
        self.on_register_changed(t, register)

    def read(self, t: float, n: int, byte_time: float) -> bytes:
        """Return `n` bytes from the pointer on; the first leaves the chip at t, one per `byte_time` s."""
        data = bytearray(n)
        for offset in range(n):
            register = self.pointer
            if register not in self.map:
                self._count_anomaly("read", register)
            else:
                data[offset] = self.read_register(t + offset * byte_time, register)
            self.pointer = self.next_register(register)
        return bytes(data)

    def _count_anomaly(self, access: str, register: int) -> None:
        """Count an access that the data sheet does not define; raise ChipAccessError if strict."""
        self.anomalies[f"{access} 0x{register:02X}"] += 1
        if self.strict:
            definition = self.map.get(register)
            kind = "unknown" if definition is None else f"read-only ({definition.name})"
            raise ChipAccessError(
                f"{type(self).__name__} at 0x{self.address:02X}: {access} of {kind} register "
                f"0x{register:02X}; "
                "correct the driver, or emulate the chip with strict=False"
            )

    def on_register_changed(self, t: float, register: int) -> None:
        """React to a stored value that changed at t."""

    def read_register(self, t: float, register: int) -> int:
        """Return the byte of a register at t, and apply the side effects of the read."""
        return self.values[register]
