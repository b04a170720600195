"""An I2C slave as its data sheet draws it: byte-addressed registers behind a sub-address pointer."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from hubodo.emulator.chips.faults import BitFlip, BrownOut, BusNack, ScriptedFault, WrongWhoAmI
from hubodo.errors import HubodoError


class ChipAccessError(HubodoError):
    """A driver touched a register that the data sheet does not give, or wrote one that is read-only."""


class NotAcknowledged(Exception):
    """The chip left SDA high in the acknowledge bit."""


@dataclass(frozen=True)
class Register:
    """One row of a register map: name, value at power-on, which bits a write can change."""

    name: str
    reset: int = 0
    writable: int = 0


@dataclass(frozen=True)
class Write:
    """One register write as the chip saw it."""

    t: float
    register: int
    value: int


class RegisterChip:
    """Registers, pointer, faults and the log of writes; a chip adds what reads and writes do.

    Args:
        name: which chip a `ScriptedFault.chip` means ("imu" or "mag").
        address: 7-bit I2C address.
        registers: sub-address to Register.
        who_am_i: (sub-address, value).
        faults: only those for this chip are heeded.
        strict: raise ChipAccessError where the real chip would quietly do something undocumented:
            an unknown register answers 0, a read-only or unknown one swallows the write. Both are
            counted in `oddities` in any case.
    """

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
        self._nacks = sorted((f for f in self.faults if isinstance(f, BusNack)), key=lambda f: f.t)
        self._upsets = sorted(
            (f for f in self.faults if isinstance(f, BitFlip | WrongWhoAmI | BrownOut)), key=lambda f: f.t
        )
        self._to_nack = 0
        self._t_event = self._upsets[0].t if self._upsets else float("inf")
        self.values = bytearray(256)
        self.pointer = 0
        self.writes: list[Write] = []
        self.oddities: Counter[str] = Counter()
        self.power_on(0.0)

    def power_on(self, t: float) -> None:
        """Registers fall to their power-on values at t."""
        self.values[:] = bytes(256)
        for register, row in self.map.items():
            self.values[register] = row.reset
        self.values[self._who_am_i[0]] = self._who_am_i[1]
        self.pointer = 0

    def acknowledge(self, t: float) -> None:
        """Address byte seen at t. Raises NotAcknowledged when a fault says so."""
        if t >= self._t_event:
            self._upset(t)
        while self._nacks and self._nacks[0].t <= t:
            self._to_nack += self._nacks.pop(0).count
        if self._to_nack:
            self._to_nack -= 1
            self.oddities["nack"] += 1
            raise NotAcknowledged

    def _upset(self, t: float) -> None:
        while self._upsets and self._upsets[0].t <= t:
            fault = self._upsets.pop(0)
            if isinstance(fault, BrownOut):
                self.power_on(fault.t)
            elif isinstance(fault, WrongWhoAmI):
                self._who_am_i = (self._who_am_i[0], fault.value)
                self.values[self._who_am_i[0]] = fault.value
            elif isinstance(fault, BitFlip):
                self.values[fault.register] ^= 1 << fault.bit
                self.written(fault.t, fault.register)
        self._t_event = self._upsets[0].t if self._upsets else float("inf")

    def write(self, t: float, data: bytes) -> None:
        """Bytes after the address byte of a write: the sub-address, then values, at t."""
        if not data:
            return
        self.set_pointer(data[0])
        for value in data[1:]:
            self._write_one(t, self.pointer, value)
            self.pointer = self.after(self.pointer)

    def set_pointer(self, sub_address: int) -> None:
        """The sub-address byte."""
        self.pointer = sub_address

    def after(self, register: int) -> int:
        """The register that a burst goes to after `register`."""
        return (register + 1) & 0xFF

    def _write_one(self, t: float, register: int, value: int) -> None:
        row = self.map.get(register)
        if row is None or not row.writable:
            self._odd("write", register)
            return
        self.writes.append(Write(t, register, value))
        self.values[register] = (self.values[register] & ~row.writable) | (value & row.writable)
        self.written(t, register)

    def read(self, t: float, n: int, byte_time: float) -> bytes:
        """`n` bytes from the pointer on, the first one leaving the chip at t, one per `byte_time` s."""
        out = bytearray(n)
        for i in range(n):
            register = self.pointer
            if register not in self.map:
                self._odd("read", register)
            else:
                out[i] = self.fetch(t + i * byte_time, register)
            self.pointer = self.after(register)
        return bytes(out)

    def _odd(self, what: str, register: int) -> None:
        self.oddities[f"{what} 0x{register:02X}"] += 1
        if self.strict:
            row = self.map.get(register)
            kind = "unknown" if row is None else f"read-only ({row.name})"
            raise ChipAccessError(
                f"{type(self).__name__} at 0x{self.address:02X}: {what} of {kind} register 0x{register:02X}; "
                "correct the driver, or run the chip with strict=False to see what silicon does"
            )

    def written(self, t: float, register: int) -> None:
        """A stored value changed at t; the chip acts on it."""

    def fetch(self, t: float, register: int) -> int:
        """The byte of `register` at t, with what reading it does."""
        return self.values[register]
