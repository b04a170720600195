"""I2C bus and GPIO pins of a board: addressing, bit timing, and a slave that holds SDA low."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from hubodo.emulator.board.hypercall import EIO, ETIMEDOUT
from hubodo.emulator.board.settings import Wiring
from hubodo.emulator.chips.faults import ScriptedFault, StuckBus
from hubodo.emulator.chips.registers import NotAcknowledged, RegisterChip

DEFAULT_HZ = 400_000
SDA_TIMEOUT_S = 0.05
_PULSES_TO_RELEASE = 9
_OPEN_DRAIN, _OUTPUT = 2, 1


@dataclass
class BusRead:
    """A read on the bus: `n` bytes from `register` on; the first leaves the chip at `t` s."""

    t: float
    address: int
    register: int
    n: int


class I2cBus:
    """I2C bus with chips; a transaction takes the time of its bits and fails as in MicroPython.

    A missing acknowledgement returns -`nack_errno` after the address byte (EIO on the rp2 port); SDA held low
    returns -ETIMEDOUT after 50 ms. MicroPython raises both as OSError. The chips are connected to the pins
    `sda` and `scl` only; wiring: see `SensorBoard`. interrupts: function for each pin from time, s, to level.
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
        interrupts: Mapping[int, Callable[[float], int]] = MappingProxyType({}),
    ) -> None:
        self.chips = {chip.address: chip for part in chips for chip in (part, *part.companions)}
        self.wiring, self.nack_errno, self.interrupts = wiring, refusal, interrupts
        self.sda_wire, self.scl_wire = (scl, sda) if wiring == "swapped" else (sda, scl)
        self.bit_time = 1.0 / DEFAULT_HZ
        self.counts: Counter[str] = Counter()
        self._stuck_times = sorted(f.t for f in faults if isinstance(f, StuckBus))
        self._pulses_to_release = 0
        self.scl_pin, self.sda_pin = scl, sda
        self._scl_level = 1
        self._started_chip: RegisterChip | None = None
        self._current_read: BusRead | None = None
        self.reads: list[BusRead] | None = None
        """Record of all reads; None to record none."""

    def initialise(self, frequency_hz: int, scl_pin: int, sda_pin: int) -> None:
        """Configure frequency and pins; pin -1 keeps the pin."""
        self.bit_time = 1.0 / max(frequency_hz, 1)
        self.scl_pin = scl_pin if scl_pin >= 0 else self.scl_pin
        self.sda_pin = sda_pin if sda_pin >= 0 else self.sda_pin

    def _is_held_low(self, pin: int) -> bool:
        """Return True if the wiring holds the line at a pin low."""
        low = {"sda_low": (self.sda_wire,), "scl_low": (self.scl_wire,)}
        both = (self.sda_wire, self.scl_wire)
        return pin in (both if self.wiring == "no_power" else low.get(self.wiring, ()))

    def _is_stuck(self, t: float) -> bool:
        """Return True while a slave holds SDA low, from the time of the scripted fault on."""
        if self._stuck_times and self._stuck_times[0] <= t:
            self._stuck_times.pop(0)
            self._pulses_to_release = _PULSES_TO_RELEASE
            self.counts["stuck"] += 1
        return self._pulses_to_release > 0

    def _address_chip(self, t: float, address: int) -> RegisterChip | int:
        """Address a chip at t; return it, or the negative errno."""
        if (self._stuck_times or self._pulses_to_release) and self._is_stuck(t):
            self.counts["timeout"] += 1
            return -ETIMEDOUT
        if self._is_held_low(self.sda_pin) or self._is_held_low(self.scl_pin):
            self.counts["timeout"] += 1
            return -ETIMEDOUT
        is_wired = (self.sda_pin, self.scl_pin) == (self.sda_wire, self.scl_wire)
        chip = self.chips.get(address) if is_wired and self.wiring != "no_pull_ups" else None
        if chip is None:
            self.counts["nack"] += 1
            return -self.nack_errno
        try:
            chip.acknowledge(t)
        except NotAcknowledged:
            self.counts["nack"] += 1
            return -self.nack_errno
        self.counts["transactions"] += 1
        return chip

    def _failure(self, t: float, status: int) -> tuple[int, float]:
        """Return the status of a failed transaction and its end."""
        return status, t + (SDA_TIMEOUT_S if status == -ETIMEDOUT else 10 * self.bit_time)

    def read_mem(self, t: float, address: int, register: bytes, n: int) -> tuple[int, bytes, float]:
        """Write the sub-address and read n bytes; return status, bytes and the time of the stop bit."""
        chip = self._address_chip(t, address)
        if isinstance(chip, int):
            status, end = self._failure(t, chip)
            return status, b"", end
        byte_time = 9 * self.bit_time
        data_at = (
            t + (1 + 2 * len(register)) * self.bit_time + (1 + len(register) + bool(register)) * byte_time
        )
        if register:
            chip.write(t, register)
        if self.reads is not None:
            self.reads.append(BusRead(data_at, address, chip.pointer, n))
        data = chip.read(data_at, n, byte_time)
        return n, data, data_at + n * byte_time + self.bit_time

    def write(self, t: float, address: int, data: bytes) -> tuple[int, float]:
        """Write bytes to a chip; return status and the time of the stop bit."""
        chip = self._address_chip(t, address)
        if isinstance(chip, int):
            return self._failure(t, chip)
        end = t + (2 + 9 * (1 + len(data))) * self.bit_time
        chip.write(end, data)
        return len(data), end

    def start(self, t: float, address: int, written: bytes) -> int:
        """Send a start condition at t, after `written` bytes to the chip before.

        Return 1, -EIO or -ETIMEDOUT.

        For a controller that transfers byte by byte and keeps the bit timing itself.
        """
        self.write_bytes(t, written)
        chip = self._address_chip(t, address)
        self._started_chip = chip if isinstance(chip, RegisterChip) else None
        self._current_read = None
        return 1 if isinstance(chip, RegisterChip) else chip

    def write_bytes(self, t: float, data: bytes) -> None:
        """Write bytes to the chip of the last start condition; the last one ends at t."""
        if self._started_chip is not None and data:
            self._started_chip.write(t, data)

    def read_byte(self, t: float) -> int:
        """Return the byte that the chip of the last start condition sends from t on."""
        if self._started_chip is None:
            return 0xFF
        if self.reads is not None:
            if self._current_read is None:
                self._current_read = BusRead(t, self._started_chip.address, self._started_chip.pointer, 0)
                self.reads.append(self._current_read)
            self._current_read.n += 1
        return self._started_chip.read(t, 1, 9 * self.bit_time)[0]

    def scan(self, t: float) -> tuple[bytes, float]:
        """Return the addresses that acknowledge, and the time after the last probe."""
        addresses = bytearray()
        for address in range(0x08, 0x78):
            if isinstance(self._address_chip(t, address), RegisterChip):
                addresses.append(address)
            t += 11 * self.bit_time
        return bytes(addresses), t

    def drive_pin(self, t: float, pin: int, level: int) -> None:
        """Set the level of a pin; edges on SCL clock a slave that holds SDA low."""
        if pin != self.scl_wire:
            return
        if level and not self._scl_level and self._is_stuck(t):
            self._pulses_to_release -= 1
            if not self._pulses_to_release:
                self.counts["freed"] += 1
        self._scl_level = level

    def level(self, t: float, pin: int, pulled_up: bool) -> int | None:
        """Return the level of a bus line at an undriven pin; None for other pins."""
        if pin not in (self.sda_wire, self.scl_wire):
            return None
        if self._is_held_low(pin) or (pin == self.sda_wire and self._is_stuck(t)):
            return 0
        return int(pulled_up or self.wiring != "no_pull_ups")


class Pins:
    """GPIO pins of the processor; levels of bus lines are passed to the bus."""

    def __init__(self, bus: I2cBus) -> None:
        self._bus = bus
        self.levels: dict[int, int] = {}
        self.modes: dict[int, int] = {}
        self.pulls: dict[int, int] = {}

    def initialise(self, t: float, pin: int, mode: int, pull: int) -> None:
        """Configure a pin.

        mode: 0 input, 1 output, 2 open drain, -1 unchanged. pull: 1 up, 2 down, -1 none.
        """
        if mode >= 0:
            self.modes[pin] = mode
        self.pulls[pin] = pull
        if self.modes.get(pin) == _OUTPUT or self.modes.get(pin) == _OPEN_DRAIN:
            self._bus.drive_pin(t, pin, self.levels.get(pin, 1 if self.modes[pin] == _OPEN_DRAIN else 0))
        else:
            self._bus.drive_pin(t, pin, 1)

    def set_level(self, t: float, pin: int, level: int) -> None:
        """Set the output level of a pin."""
        self.levels[pin] = level
        if self.modes.get(pin) in (_OUTPUT, _OPEN_DRAIN):
            self._bus.drive_pin(t, pin, level)

    def drives_high(self, pin: int) -> bool:
        """Return True if the processor drives the pin high."""
        return self.modes.get(pin) == _OUTPUT and bool(self.levels.get(pin, 0))

    def get_level(self, t: float, pin: int) -> int:
        """Return the level at a pin; bus lines are pulled up, and a stuck slave pulls SDA low."""
        if pin in self._bus.interrupts:
            return self._bus.interrupts[pin](t)
        mode, level = self.modes.get(pin), self.levels.get(pin, 1)
        if mode == _OUTPUT or (mode == _OPEN_DRAIN and not level):
            return self.levels.get(pin, 0)
        on_bus = self._bus.level(t, pin, self.pulls.get(pin) == 1)
        if on_bus is not None:
            return on_bus
        return level if mode == _OPEN_DRAIN else int(self.pulls.get(pin) == 1)
