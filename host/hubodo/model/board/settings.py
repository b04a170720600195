"""What can be chosen about a virtual board."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hubodo.model.board.interpreter import Kind
from hubodo.model.board.models import ModelName

Wiring = Literal["good", "swapped", "no_pull_ups", "no_power", "sda_low", "scl_low"]


@dataclass(frozen=True)
class BoardSettings:
    """What board it is and how its time runs.

    Attributes:
        flash: host directory that is the board's file system; changed by what the board writes.
        model: which board it is, see `models`.
        wiring: how the sensor board hangs on it. "no_pull_ups": lines that nothing pulls (nothing connected
            looks the same); too slow for 400 kHz, so nobody answers. "no_power": the sensor board's pull-ups
            pull both lines to its dead supply.
        flash_journal: file that takes a JSON line for every change of the file system, in order.
        clock: "real" is time.monotonic; "stepped" advances by sleeps, wire time and the cost of calls
            alone, as fast as it can; "paced" is stepped but never ahead of time.monotonic: where the host
            machine is too slow for a while, the board's whole world waits and catches up, and loses nothing.
        clock_ppm: the device clock gains this much on true time.
        ticks_start_us: time.ticks_us() at power-on; ticks wrap at 2**30.
        heap_bytes: MicroPython heap, the board's own modules not counted.
        call_cost_us: stepped and paced clock, what each call to the board takes beyond its wire time.
        tick_cost_us: stepped and paced clock, what a look at the clock or at standard input takes.
        battery_mv: the supply, at the divider of the model.
        uart_link: None: the link is USB CDC; else it is the UART of that number.
        unique_id: of the processor, in hexadecimal.
        run_for: s of true time after which the board is switched off, or None.
        wait_for_host: switched on only when a host has the port open.
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
    uart_link: int | None = None
    run_for: float | None = None
    wait_for_host: bool = False
    power_on_ns: int | None = None
