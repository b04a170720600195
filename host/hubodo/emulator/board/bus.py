"""The I2C bus and the pins it hangs on: addressing, wire time, a slave that holds SDA low."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from hubodo.emulator.board.hypercall import EIO, ETIMEDOUT
from hubodo.emulator.board.settings import Wiring
from hubodo.emulator.chips.faults import ScriptedFault, StuckBus
from hubodo.emulator.chips.registers import NotAcknowledged, RegisterChip

DEFAULT_HZ = 400_000
TIMEOUT_S = 0.05
_PULSES_TO_FREE = 9
_OPEN_DRAIN, _OUT = 2, 1


@dataclass
class Read:
    """One read as the bus saw it: `n` bytes from `register` on, the first one leaving the chip at `t` s."""

    t: float
    address: int
    register: int
    n: int


class I2cBus:
    """Chips on two wires; every transaction takes its bits' time and fails as MicroPython reports it.

    A refused address is -`refusal` after the address byte, EIO on the rp2 port, a held SDA is -ETIMEDOUT
    after 50 ms; MicroPython raises them as OSError. The chips hang on the pins `sda` and `scl`, and answer
    there alone; wiring: see `BoardSettings`.
    """

    def __init__(
        self,
        chips: Sequence[RegisterChip],
        faults: Sequence[ScriptedFault] = (),
        *,
        sda: int = 0,
        scl: int = 1,
        wiring: Wiring = "good",
        refusal: int = EIO,
    ) -> None:
        self.chips = {chip.address: chip for chip in chips}
        self.wiring, self.refusal = wiring, refusal
        self.sda_wire, self.scl_wire = (scl, sda) if wiring == "swapped" else (sda, scl)
        self.bit_time = 1.0 / DEFAULT_HZ
        self.counts: Counter[str] = Counter()
        self._stuck_at = sorted(f.t for f in faults if isinstance(f, StuckBus))
        self._pulses_left = 0
        self.scl_pin, self.sda_pin = scl, sda
        self._scl_level = 1
        self._open: RegisterChip | None = None
        self._reading: Read | None = None
        self.reads: list[Read] | None = None
        """Every read, where a list is put here."""

    def initialise(self, frequency_hz: int, scl_pin: int, sda_pin: int) -> None:
        """Take the bus at `frequency_hz`; pin -1 keeps the pin."""
        self.bit_time = 1.0 / max(frequency_hz, 1)
        self.scl_pin = scl_pin if scl_pin >= 0 else self.scl_pin
        self.sda_pin = sda_pin if sda_pin >= 0 else self.sda_pin

    def _held(self, pin: int) -> bool:
        """Whether the wiring holds the line at a pin low."""
        low = {"sda_low": (self.sda_wire,), "scl_low": (self.scl_wire,)}
        both = (self.sda_wire, self.scl_wire)
        return pin in (both if self.wiring == "no_power" else low.get(self.wiring, ()))

    def _stuck(self, t: float) -> bool:
        if self._stuck_at and self._stuck_at[0] <= t:
            self._stuck_at.pop(0)
            self._pulses_left = _PULSES_TO_FREE
            self.counts["stuck"] += 1
        return self._pulses_left > 0

    def _addressed(self, t: float, address: int) -> RegisterChip | int:
        if (self._stuck_at or self._pulses_left) and self._stuck(t):
            self.counts["timeout"] += 1
            return -ETIMEDOUT
        if self._held(self.sda_pin) or self._held(self.scl_pin):
            self.counts["timeout"] += 1
            return -ETIMEDOUT
        wired = (self.sda_pin, self.scl_pin) == (self.sda_wire, self.scl_wire)
        chip = self.chips.get(address) if wired and self.wiring != "no_pull_ups" else None
        if chip is None:
            self.counts["nack"] += 1
            return -self.refusal
        try:
            chip.acknowledge(t)
        except NotAcknowledged:
            self.counts["nack"] += 1
            return -self.refusal
        self.counts["transactions"] += 1
        return chip

    def _failed(self, t: float, status: int) -> tuple[int, float]:
        return status, t + (TIMEOUT_S if status == -ETIMEDOUT else 10 * self.bit_time)

    def read_mem(self, t: float, address: int, register: bytes, n: int) -> tuple[int, bytes, float]:
        """Write the sub-address, repeated start, read n bytes: status, bytes, time at the stop bit."""
        chip = self._addressed(t, address)
        if isinstance(chip, int):
            status, end = self._failed(t, chip)
            return status, b"", end
        byte_time = 9 * self.bit_time
        data_at = (
            t + (1 + 2 * len(register)) * self.bit_time + (1 + len(register) + bool(register)) * byte_time
        )
        if register:
            chip.write(t, register)
        if self.reads is not None:
            self.reads.append(Read(data_at, address, chip.pointer, n))
        data = chip.read(data_at, n, byte_time)
        return n, data, data_at + n * byte_time + self.bit_time

    def write(self, t: float, address: int, data: bytes) -> tuple[int, float]:
        """Address and data bytes. Returns status and the time at the stop bit."""
        chip = self._addressed(t, address)
        if isinstance(chip, int):
            return self._failed(t, chip)
        end = t + (2 + 9 * (1 + len(data))) * self.bit_time
        chip.write(end, data)
        return len(data), end

    def start(self, t: float, address: int, written: bytes) -> int:
        """A start condition at t, after `written` went to the chip before: 1, -EIO or -ETIMEDOUT.

        For a controller that sends byte by byte and keeps the time of the bits itself.
        """
        self.put(t, written)
        chip = self._addressed(t, address)
        self._open = chip if isinstance(chip, RegisterChip) else None
        self._reading = None
        return 1 if isinstance(chip, RegisterChip) else chip

    def put(self, t: float, data: bytes) -> None:
        """Bytes for the chip of the last start, the last one over at t."""
        if self._open is not None and data:
            self._open.write(t, data)

    def take(self, t: float) -> int:
        """The byte that the chip of the last start shows from t on."""
        if self._open is None:
            return 0xFF
        if self.reads is not None:
            if self._reading is None:
                self._reading = Read(t, self._open.address, self._open.pointer, 0)
                self.reads.append(self._reading)
            self._reading.n += 1
        return self._open.read(t, 1, 9 * self.bit_time)[0]

    def scan(self, t: float) -> tuple[bytes, float]:
        """Addresses that acknowledge, and the time after the last probe."""
        found = bytearray()
        for address in range(0x08, 0x78):
            if isinstance(self._addressed(t, address), RegisterChip):
                found.append(address)
            t += 11 * self.bit_time
        return bytes(found), t

    def pin_driven(self, t: float, pin: int, level: int) -> None:
        """SCL moved by hand: each falling and rising edge clocks the slave that holds SDA."""
        if pin != self.scl_wire:
            return
        if level and not self._scl_level and self._stuck(t):
            self._pulses_left -= 1
            if not self._pulses_left:
                self.counts["freed"] += 1
        self._scl_level = level

    def level(self, t: float, pin: int, pulled_up: bool) -> int | None:
        """What a pin that drives nothing reads on a line of the bus; None for other pins."""
        if pin not in (self.sda_wire, self.scl_wire):
            return None
        if self._held(pin) or (pin == self.sda_wire and self._stuck(t)):
            return 0
        return int(pulled_up or self.wiring != "no_pull_ups")


class Pins:
    """GPIO levels; those of the bus go to the bus."""

    def __init__(self, bus: I2cBus) -> None:
        self._bus = bus
        self.levels: dict[int, int] = {}
        self.modes: dict[int, int] = {}
        self.pulls: dict[int, int] = {}

    def initialise(self, t: float, pin: int, mode: int, pull: int) -> None:
        """Mode 0 in, 1 out, 2 open drain, -1 as it is; pull 1 up, 2 down, -1 none."""
        if mode >= 0:
            self.modes[pin] = mode
        self.pulls[pin] = pull
        if self.modes.get(pin) == _OUT or self.modes.get(pin) == _OPEN_DRAIN:
            self._bus.pin_driven(t, pin, self.levels.get(pin, 1 if self.modes[pin] == _OPEN_DRAIN else 0))
        else:
            self._bus.pin_driven(t, pin, 1)

    def set(self, t: float, pin: int, level: int) -> None:
        """Drive the pin."""
        self.levels[pin] = level
        if self.modes.get(pin) in (_OUT, _OPEN_DRAIN):
            self._bus.pin_driven(t, pin, level)

    def drives_high(self, pin: int) -> bool:
        """Whether the processor holds the pin high."""
        return self.modes.get(pin) == _OUT and bool(self.levels.get(pin, 0))

    def get(self, t: float, pin: int) -> int:
        """Level on the pin: the bus lines are pulled up, a stuck slave pulls SDA down."""
        mode, level = self.modes.get(pin), self.levels.get(pin, 1)
        if mode == _OUT or (mode == _OPEN_DRAIN and not level):
            return self.levels.get(pin, 0)
        on_bus = self._bus.level(t, pin, self.pulls.get(pin) == 1)
        if on_bus is not None:
            return on_bus
        return level if mode == _OPEN_DRAIN else int(self.pulls.get(pin) == 1)
