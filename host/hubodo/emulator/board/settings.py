"""What can be chosen about a virtual board."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hubodo.emulator.board.interpreter import Kind
from hubodo.emulator.board.models import ModelName
from hubodo.emulator.board.network import Air

Wiring = Literal["good", "swapped", "no_pull_ups", "no_power", "sda_low", "scl_low"]


@dataclass(frozen=True)
class BoardSettings:
    """What board it is and how its time runs.

    Attributes:
        flash: host directory that is the board's file system; changed by what the board writes.
        model: which board it is, see `models`. Both ports' UARTs hold a write up until all of it is in the
            send buffer; rp2 tells beforehand whether there is room, ESP32 always says yes, and its console is
            such a UART as well.
        wiring: how the sensor board hangs on it. "no_pull_ups": lines that nothing pulls (nothing connected
            looks the same); too slow for 400 kHz, so nobody answers. "no_power": the sensor board's pull-ups
            pull both lines to its dead supply.
        flash_journal: file that takes a JSON line for every change of the file system, in order.
        clock: "real" is time.monotonic; "stepped" advances by sleeps, wire time and the cost of calls
            alone, as fast as it can; "paced" is stepped but never ahead of time.monotonic: where the host
            machine is too slow for a while, the board's whole world waits and catches up, and loses nothing.
        clock_ppm: the device clock gains this much on true time.
        ticks_start_us: time.ticks_us() at power-on; ticks wrap at 2**30.
        heap_bytes: MicroPython heap, the board's own modules not counted; a Pico has what it has.
        call_cost_us: stepped and paced clock, what each call to the board takes beyond its wire time; a Pico
            takes the cycles that it takes.
        tick_cost_us: stepped and paced clock, what a look at the clock or at standard input takes.
        battery_mv: the supply, at the divider of the model.
        air: the Wi-Fi around the board.
        uart_link: None: the link is USB CDC; else it is the UART of that number.
        unique_id: of the processor, in hexadecimal.
        run_for: s of true time after which the board is switched off, or None.
        wait_for_host: switched on only when a host has the port open.
        pace: with a paced clock, s of the wall clock in which the board lives one; for what cannot keep up.
        image, bootrom: of an emulated Pico, see `rp2040.image.find_image`; None: the usual ones.
        miss_cycles: rp2040, cycles of the processor per miss of the cache before its flash; an estimate.
        flash_image: rp2040, file that is the flash chip; used as it is where it exists, else made from
            `flash`. None: a temporary one, made anew at each power-on.
        meter_from: rp2040, s of true time from which it is counted what the processor does; None: never.
        profile: rp2040, whether that is told for each function of the firmware too.
        power_on_ns: time.monotonic_ns() at which it is switched on, so that several boards share one zero
            of time; None: at once.
    """

    flash: Path
    model: ModelName = "pico"
    wiring: Wiring = "good"
    flash_journal: Path | None = None
    interpreter: Kind = "micropython"
    clock: Literal["real", "paced", "stepped"] = "real"
    clock_ppm: float = 0.0
    ticks_start_us: int = 0
    heap_bytes: int = 192 * 1024
    call_cost_us: float = 30.0
    tick_cost_us: float = 10.0
    battery_mv: float = 3700.0
    unique_id: str = "e6614103e7452d2f"
    air: Air = Air()
    uart_link: int | None = None
    run_for: float | None = None
    wait_for_host: bool = False
    pace: float = 1.0
    image: Path | None = None
    bootrom: Path | None = None
    miss_cycles: int = 50
    flash_image: Path | None = None
    meter_from: float | None = None
    profile: bool = False
    power_on_ns: int | None = None

    def __post_init__(self) -> None:
        if self.pace <= 0 or (self.pace != 1 and self.clock != "paced"):
            raise ValueError(f"pace {self.pace}: want a number above 0, other than 1 only with a paced clock")
        if self.interpreter == "rp2040" and self.clock == "real":
            raise ValueError("an emulated Pico has a clock of its own: want clock stepped or paced")
