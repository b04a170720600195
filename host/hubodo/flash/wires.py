"""The I2C lines of a board as its own pins see them, and what answers there: a look through the REPL."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.flash.check_result import CheckResult, ok, wrong
from hubodo.flash.image import firmware_folder
from hubowire.messages import Board

# Lines that are held low answer to every address, so a scan means nothing there. 100 kHz: weak pull-ups do.
_LOOK = """
import machine,time
def see(n):
    r=[]
    for p in (machine.Pin.PULL_DOWN,machine.Pin.PULL_UP):
        q=machine.Pin(n,machine.Pin.IN,p)
        time.sleep_ms(5)
        r.append(q.value())
    return tuple(r)
def scan(a,b):
    try:
        c=machine.SoftI2C(sda=machine.Pin(a),scl=machine.Pin(b),freq=100000,timeout=5000)
        return [(n,who(c,n)) for n in c.scan()]
    except OSError:
        return []
def who(c,n):
    try:
        return c.readfrom_mem(n,{registers}[n],1)[0] if n in {registers} else -1
    except OSError:
        return -1
a,b={sda},{scl}
s,t=see(a),see(b)
f,g=[],[]
if s[1] and t[1]:
    f=scan(a,b)
    g=[] if f else scan(b,a)
print((s,t,f,g))
"""

KNOWN = {
    (0x0F, 0x69): "LSM6DS33, or an LSM6DS3 or DS3H, which answer the same",
    (0x0F, 0x6A): "LSM6DSL, LSM6DSM or LSM6DS3TR-C",
    (0x0F, 0x6B): "LSM6DSR or ASM330",
    (0x0F, 0x6C): "LSM6DSO or LSM6DSOX, which sits on Pololu's later boards",
    (0x0F, 0x3D): "LIS3MDL",
    (0x75, 0x68): "MPU-6050",
    (0x75, 0x70): "MPU-6500",
    (0x75, 0x71): "MPU-9250",
    (0x75, 0x73): "MPU-9255",
    (0x75, 0x98): "another chip on a module sold as MPU-6050; 13 of 20 in one delivery",
}
"""(register of the identity, what it reads): the silicon behind it."""
_REGISTER = {0x6A: 0x0F, 0x6B: 0x0F, 0x1C: 0x0F, 0x1E: 0x0F, 0x68: 0x75, 0x69: 0x75}


def chip_name(address: int, who_am_i: int) -> str:
    """What answers at an address with this identity, in words."""
    if who_am_i < 0:
        return f"0x{address:02X}: a chip that is not asked for its id"
    known = KNOWN.get((_REGISTER.get(address, -1), who_am_i), "a chip that is not known here")
    return f"0x{address:02X} answers 0x{who_am_i:02X}: {known}"


@dataclass(frozen=True)
class Wires:
    """What a look found. sda, scl: pins; their levels pulled down and pulled up.

    found, swapped: (address, WHO_AM_I) of what answers, as wired and with the two lines exchanged.
    """

    sda: int
    scl: int
    sda_levels: tuple[int, int]
    scl_levels: tuple[int, int]
    found: tuple[tuple[int, int], ...]
    swapped: tuple[tuple[int, int], ...]


def board_pins(machine: str, config: Mapping[str, object]) -> tuple[Board, dict[str, int]]:
    """Which board this is and its pins, by the firmware's own table and the node's settings."""
    path = firmware_folder() / "pins.py"
    names: dict[str, Any] = {f"BOARD_{board.name}": board for board in Board}
    exec(compile(_without_imports(path), str(path), "exec"), names)
    board, pins = names["board_of"](machine)
    told = config.get("pins")
    return board, pins | (told if isinstance(told, dict) else {})


def _without_imports(path: Path) -> ast.Module:
    tree = ast.parse(path.read_text())
    tree.body = [line for line in tree.body if not isinstance(line, ast.ImportFrom)]
    return tree


def look(pins: Mapping[str, int], run: Callable[[str], str]) -> Wires:
    """Looks at the lines. run: has the board run a piece of Python, and gives what it prints."""
    text = run(_LOOK.format(sda=pins["sda"], scl=pins["scl"], registers=_REGISTER))
    sda, scl, found, swapped = ast.literal_eval(text.strip().splitlines()[-1])
    return Wires(pins["sda"], pins["scl"], sda, scl, tuple(found), tuple(swapped))


def judge_wires(wires: Wires) -> CheckResult:
    """What the lines and the scan say of the wiring."""
    names = f"SDA GPIO{wires.sda}, SCL GPIO{wires.scl}"
    lines = (("SDA", wires.sda, wires.sda_levels), ("SCL", wires.scl, wires.scl_levels))
    low = [f"{name} (GPIO{pin})" for name, pin, levels in lines if not levels[1]]
    floating = [f"{name} (GPIO{pin})" for name, pin, levels in lines if levels == (0, 1)]
    if len(low) == 2:
        return wrong(
            "wires",
            f"both lines are held low: {' and '.join(low)}",
            "the sensor board has no supply, and its pull-ups pull to that: 3V3 to VIN or 3V, GND to GND",
        )
    if low:
        return wrong(
            "wires",
            f"{low[0]} is held low",
            "take the power off and on; if it stays: a short to GND or to a neighbour, or a broken chip",
        )
    if floating:
        return wrong(
            "wires",
            f"nothing pulls up {' and '.join(floating)}",
            "connect the sensor board; a bare chip needs 4.7 kΩ from SDA and from SCL to 3V3",
        )
    if wires.found:
        return ok("wires", f"{names}, both pulled up; " + ", ".join(chip_name(*chip) for chip in wires.found))
    if wires.swapped:
        there = ", ".join(f"0x{address:02X}" for address, _ in wires.swapped)
        return wrong(
            "wires",
            f"SDA and SCL are exchanged: {there} answers with the two the other way round",
            f"the sensor board's SDA goes to GPIO{wires.sda}, its SCL to GPIO{wires.scl}",
        )
    return wrong(
        "wires",
        f"{names}, both pulled up, but nothing answers",
        "wires that went to other pins? A chip strapped to SPI (CS must be high)? A broken chip?",
    )
