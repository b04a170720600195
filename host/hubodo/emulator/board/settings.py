"""What can be chosen about a virtual node: its flash, sensors, clock, host, and the board itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from hubodo.emulator.board.models import ModelName
from hubodo.emulator.board.network import Air
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.interpreters.interpreter import Kind
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings

Wiring = Literal["good", "swapped", "no_pull_ups", "no_power", "sda_low", "scl_low"]
ChipName = Literal["lsm6ds33", "mpu6050", "mpu6500"]


@dataclass(frozen=True)
class Flash:
    """The board's file system when it is switched on.

    Attributes:
        firmware: directory with main.py and what it imports; None leaves the file system as it is.
        config: written to /config.json of the board; None writes none.
        folder: host directory that is the file system, kept afterwards; a temporary one when None.
        journal: file that takes a JSON line for every change of the file system, in order.
    """

    firmware: Path | None = None
    config: Mapping[str, object] | None = None
    folder: Path | None = None
    journal: Path | None = None


@dataclass(frozen=True)
class SensorBoard:
    """What hangs on the I2C bus.

    Attributes:
        chip: which IMU. A LIS3MDL is beside it unless `magnetometer` is False.
        specimen: how the chips differ from their data sheet; its seed and faults are those of the node, and
            its registers are strict.
        wiring: how it is connected. "no_pull_ups": lines that nothing pulls (nothing connected looks the
            same); too slow for 400 kHz, so nobody answers. "no_power": the sensor board's pull-ups pull both
            lines to its dead supply.
        log: whether every read of the bus is kept.
    """

    chip: ChipName = "lsm6ds33"
    magnetometer: bool = True
    specimen: Specimen = field(default_factory=Specimen)
    wiring: Wiring = "good"
    log: bool = False


@dataclass(frozen=True)
class Clock:
    """How the board's time runs.

    Attributes:
        kind: "real" is time.monotonic; "stepped" advances by sleeps, wire time and the cost of calls alone,
            as fast as it can; "paced" is stepped but never ahead of time.monotonic: where the host machine is
            too slow for a while, the board's whole world waits and catches up, and loses nothing; "led" is
            stepped as far as `VirtualNode.live_until` lets it.
        run_for: s of true time after which the board is switched off, or None.
        ppm: the device clock gains this much on true time.
        ticks_start_us: time.ticks_us() at power-on; ticks wrap at 2**30.
        pace: with a paced clock, s of the wall clock in which the board lives one; for what cannot keep up.
        power_on_ns: time.monotonic_ns() at which it is switched on, so that several boards share one zero
            of time; None: at once.
        call_cost_us: stepped and paced, what each call to the board takes beyond its wire time; a Pico takes
            the cycles that it takes.
        tick_cost_us: stepped and paced, what a look at the clock or at standard input takes.
    """

    kind: Literal["real", "paced", "stepped", "led"] = "real"
    run_for: float | None = None
    ppm: float = 0.0
    ticks_start_us: int = 0
    pace: float = 1.0
    power_on_ns: int | None = None
    call_cost_us: float = 30.0
    tick_cost_us: float = 10.0

    def __post_init__(self) -> None:
        if self.pace <= 0 or (self.pace != 1 and self.kind != "paced"):
            raise ValueError(f"pace {self.pace}: want a number above 0, other than 1 only with a paced clock")


@dataclass(frozen=True)
class Host:
    """What is at the other end of the board's link.

    Attributes:
        link: "pty" USB CDC on a pseudo terminal; "uart" the same terminal on UART 0; "udp" the firmware sends
            by itself, the terminal is its console; "memory" no host, output is kept.
        path: where the symbolic link on the terminal of the moment shall be; made up when None.
        wait: whether the board is switched on only when a host has the port open.
        script: with link "memory", (s, bytes) that reach the board at these times.
        deaf: with link "memory", (from s, to s) in which the host has the port open and does not read.
        corrupt, lose: probability per byte from the board that it is changed, or missing.
        log: whether everything the board writes is kept, with and without that noise.
    """

    link: Literal["pty", "uart", "udp", "memory"] = "pty"
    path: Path | None = None
    wait: bool = False
    script: tuple[tuple[float, bytes], ...] = ()
    deaf: tuple[tuple[float, float], ...] = ()
    corrupt: float = 0.0
    lose: float = 0.0
    log: bool = False


@dataclass(frozen=True)
class BoardSettings:
    """What board it is, what runs its firmware, and what is around it.

    Attributes:
        model: which board it is, see `models`. Both ports' UARTs hold a write up until all of it is in the
            send buffer; rp2 tells beforehand whether there is room, ESP32 always says yes, and its console is
            such a UART as well.
        interpreter: "micropython" (node and npm package needed), "cpython", or "rp2040": an emulated Pico
            that runs its own MicroPython (node, npm package and image needed, see `rp2040.image`).
        pico: of an emulated Pico, see there.
        heap_bytes: MicroPython heap, the board's own modules not counted; a Pico has what it has.
        unique_id: of the processor, in hexadecimal.
        random_seed: of what the board calls random; None: as random as this computer's; an emulated RP2040
            has its own.
        uart_link: None: the link is USB CDC; else it is the UART of that number.
        battery_mv: the supply, at the divider of the model.
        air: the Wi-Fi around the board.
    """

    model: ModelName = "pico"
    interpreter: Kind = "micropython"
    pico: PicoSettings = field(default_factory=PicoSettings)
    heap_bytes: int = 192 * 1024
    unique_id: str = "e6614103e7452d2f"
    random_seed: int | None = None
    uart_link: int | None = None
    battery_mv: float = 3700.0
    air: Air = field(default_factory=Air)

    @property
    def emulated(self) -> bool:
        """Whether the processor is emulated as well: its own MicroPython then looks for ctrl-C."""
        return self.interpreter == "rp2040"
