"""Settings of a virtual node: flash, sensors, clock, host and board."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from hubodo.emulator.board.models import ModelName
from hubodo.emulator.board.network import WifiEnvironment
from hubodo.emulator.chips.imu import Specimen
from hubodo.emulator.interpreters.interpreter import InterpreterKind
from hubodo.emulator.interpreters.rp2040.pico import PicoSettings

Wiring = Literal["good", "swapped", "no_pull_ups", "no_power", "sda_low", "scl_low"]


@dataclass(frozen=True)
class Flash:
    """File system of the board at power-on.

    Attributes
    ----------
    firmware : directory with main.py and its modules; None leaves the file system unchanged.
    config : contents of /config.json of the board; None writes none.
    folder : host directory that holds the file system, and is kept; None for a temporary one.
    journal : file that receives a JSON line for each change of the file system, in order.
    """

    firmware: Path | None = None
    config: Mapping[str, object] | None = None
    folder: Path | None = None
    journal: Path | None = None


@dataclass(frozen=True)
class SensorBoard:
    """Chips on the I2C bus.

    Attributes
    ----------
    chip : name of the IMU, see `chips.catalogue`.
    magnetometer : True if a magnetometer is on the bus as well.
    magnetometer_chip : its name, see `chips.catalogue`.
    high_g : True if an ADXL375 is on the bus as well.
    specimen : deviations of the chips from their data sheets; seed and faults are set by the node, and
        register access is strict unless a chip has the identity of another one.
    wiring : wiring of the bus. "no_pull_ups": lines without pull-up resistors (or nothing connected); too
        slow for 400 kHz, so no chip responds. "no_power": the pull-ups pull both lines to the unpowered
        supply.
    log : True to record every read of the bus.
    interrupt_pin : pin of the board that is wired to INT1 of the IMU, or None.
    select_pin : pin of the board that is the chip select of an IMU on SPI; None: the IMU is on I2C.
    """

    chip: str = "lsm6ds33"
    magnetometer: bool = True
    magnetometer_chip: str = "lis3mdl"
    high_g: bool = False
    specimen: Specimen = field(default_factory=Specimen)
    wiring: Wiring = "good"
    log: bool = False
    interrupt_pin: int | None = None
    select_pin: int | None = None


@dataclass(frozen=True)
class Clock:
    """Time of the board.

    Attributes
    ----------
    kind : "real" is time.monotonic. "stepped" is virtual time, advanced only by sleeps, bus transfers and the
        cost of calls, as fast as possible. "paced" is stepped but never ahead of time.monotonic: if the host
        is too slow, the board waits and loses nothing. "lockstep" is stepped up to the limit set by
        `VirtualNode.run_until`.
    run_for : s of true time after which the board is switched off, or None.
    ppm : 1e-6, frequency error of the device clock.
    sleep_ppm : 1e-6, on top of `ppm`, error of the oscillator that keeps time in `machine.lightsleep`.
    ticks_start_us : time.ticks_us() at power-on; ticks wrap at 2**30.
    pace : with a paced clock, seconds of wall time per second of the board.
    power_on_ns : time.monotonic_ns() at power-on, so that several boards share one zero of time; None for
        now.
    call_cost_us : with virtual time, duration of a call to the board beyond the bus transfer; an emulated
        Pico counts its own cycles.
    tick_cost_us : with virtual time, duration of a read of the clock or of standard input.
    """

    kind: Literal["real", "paced", "stepped", "lockstep"] = "real"
    run_for: float | None = None
    ppm: float = 0.0
    sleep_ppm: float = 0.0
    ticks_start_us: int = 0
    pace: float = 1.0
    power_on_ns: int | None = None
    call_cost_us: float = 30.0
    tick_cost_us: float = 10.0

    def __post_init__(self) -> None:
        if self.pace <= 0 or (self.pace != 1 and self.kind != "paced"):
            raise ValueError(f"pace {self.pace}: must be above 0, and 1 unless the clock is paced")


@dataclass(frozen=True)
class Host:
    """Host at the other end of the link of the board.

    Attributes
    ----------
    link : "pty" for USB CDC on a pseudo terminal; "uart" for the same terminal on UART 0; "udp" if the
        firmware sends by Wi-Fi, with the terminal as its console; "memory" for no host, with the output
        recorded.
    path : symbolic link to the current terminal; chosen automatically if None.
    wait : True to switch the board on only when a host has opened the port.
    script : with link "memory", (s, bytes) that the board receives at these times.
    read_pauses : with link "memory", (from s, to s) in which the host has the port open but does not read.
    corrupt, lose : probabilities that a byte from the board is changed, or lost.
    log : True to record the bytes that the board writes, with and without that noise.
    """

    link: Literal["pty", "uart", "udp", "memory"] = "pty"
    path: Path | None = None
    wait: bool = False
    script: tuple[tuple[float, bytes], ...] = ()
    read_pauses: tuple[tuple[float, float], ...] = ()
    corrupt: float = 0.0
    lose: float = 0.0
    log: bool = False


@dataclass(frozen=True)
class BoardSettings:
    """Board, its interpreter and its environment.

    Attributes
    ----------
    model : board, see `models`. On all ports a UART blocks a write until it is in the send buffer; rp2
        reports beforehand whether there is space, ESP32 always reports that there is, and its console is such
        a UART too.
    interpreter : "micropython" (needs node and an npm package), "cpython", or "rp2040": an emulated Pico with
        its own MicroPython (needs node, an npm package and an image, see `rp2040.image`).
    pico : settings of an emulated Pico.
    heap_bytes : size of the MicroPython heap, without the modules of the board; that in WebAssembly collects
        no garbage while its program runs. An emulated Pico has its own.
    unique_id : identity of the processor, hexadecimal.
    random_seed : seed of os.urandom of the board; None for true randomness; an emulated RP2040 has its own
        source.
    uart_link : number of the UART that is the link to the host; None for USB CDC.
    battery_mv, battery_mv_per_s : mV and mV/s, supply voltage at the divider of the model at power-on, and
        its change.
    wifi : Wi-Fi environment of the board.
    """

    model: ModelName = "pico"
    interpreter: InterpreterKind = "micropython"
    pico: PicoSettings = field(default_factory=PicoSettings)
    heap_bytes: int = 256 * 1024
    unique_id: str = "e6614103e7452d2f"
    random_seed: int | None = None
    uart_link: int | None = None
    battery_mv: float = 3700.0
    battery_mv_per_s: float = 0.0
    wifi: WifiEnvironment = field(default_factory=WifiEnvironment)

    @property
    def is_emulated(self) -> bool:
        """True if the processor is emulated as well; its own MicroPython then detects ctrl-C."""
        return self.interpreter == "rp2040"
