"""The I2C wiring of a board: levels of its lines and devices on the bus, tested over the prompt."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.flash.check_result import CheckResult, failed_check, passed_check
from hubodo.flash.image import firmware_folder
from hubowire.messages import Board

# A line held low seems to answer at every address, so the scan needs both lines high. 100 kHz suits weak
# pull-ups.
_TEST_CODE = """
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

KNOWN_CHIPS = {
    (0x0F, 0x69): "LSM6DS33, LSM6DS3 or LSM6DS3H (same identity)",
    (0x0F, 0x6A): "LSM6DSL, LSM6DSM or LSM6DS3TR-C",
    (0x0F, 0x6B): "LSM6DSR or ASM330",
    (0x0F, 0x6C): "LSM6DSO or LSM6DSOX, used on later Pololu boards",
    (0x0F, 0x70): "LSM6DSV, LSM6DSV16X or LSM6DSV32X (same identity; the last is not served)",
    (0x0F, 0x73): "LSM6DSV320X or LSM6DSV80X",
    (0x0F, 0x3D): "LIS3MDL",
    (0x0D, 0xFF): "QMC5883L",
    (0x2F, 0x30): "MMC5983MA",
    (0x75, 0x68): "MPU-6050",
    (0x75, 0x47): "ICM-42688-P",
    (0x75, 0x70): "MPU-6500",
    (0x75, 0x71): "MPU-9250",
    (0x75, 0x73): "MPU-9255",
    (0x75, 0x98): "another chip on a module sold as MPU-6050; 13 of 20 in one delivery",
}
"""Chip by (identity register, value)."""
_IDENTITY_REGISTERS = {
    0x6A: 0x0F,
    0x6B: 0x0F,
    0x1C: 0x0F,
    0x1E: 0x0F,
    0x0D: 0x0D,
    0x30: 0x2F,
    0x68: 0x75,
    0x69: 0x75,
}


def describe_device(address: int, who_am_i: int) -> str:
    """Return a description of the device at an address with this identity."""
    if who_am_i < 0:
        return f"0x{address:02X}: a chip without a known identity register"
    name = KNOWN_CHIPS.get((_IDENTITY_REGISTERS.get(address, -1), who_am_i), "an unknown chip")
    return f"0x{address:02X} answers 0x{who_am_i:02X}: {name}"


@dataclass(frozen=True)
class WiringState:
    """The state of the I2C lines.

    Attributes
    ----------
    sda, scl
        GPIO numbers.
    sda_levels, scl_levels
        Levels with pull-down and with pull-up.
    devices, swapped_devices
        (address, identity) of the devices that answer, as wired and with SDA and SCL exchanged.
    """

    sda: int
    scl: int
    sda_levels: tuple[int, int]
    scl_levels: tuple[int, int]
    devices: tuple[tuple[int, int], ...]
    swapped_devices: tuple[tuple[int, int], ...]


def find_board_pins(machine: str, config: Mapping[str, object]) -> tuple[Board, dict[str, int]]:
    """Return board type and pins, from the firmware's table and the node's settings."""
    path = firmware_folder() / "pins.py"
    names: dict[str, Any] = {f"BOARD_{board.name}": board for board in Board}
    exec(compile(_without_imports(path), str(path), "exec"), names)
    board, pins = names["board_of"](machine)
    configured = config.get("pins")
    return board, pins | (configured if isinstance(configured, dict) else {})


def _without_imports(path: Path) -> ast.Module:
    tree = ast.parse(path.read_text())
    tree.body = [line for line in tree.body if not isinstance(line, ast.ImportFrom)]
    return tree


def measure_lines(pins: Mapping[str, int], run: Callable[[str], str]) -> WiringState:
    """Test the lines; `run` executes code on the board and returns its output."""
    text = run(_TEST_CODE.format(sda=pins["sda"], scl=pins["scl"], registers=_IDENTITY_REGISTERS))
    sda, scl, devices, swapped = ast.literal_eval(text.strip().splitlines()[-1])
    return WiringState(pins["sda"], pins["scl"], sda, scl, tuple(devices), tuple(swapped))


def check_wiring(wires: WiringState) -> CheckResult:
    """Return the check of the wiring."""
    names = f"SDA GPIO{wires.sda}, SCL GPIO{wires.scl}"
    lines = (("SDA", wires.sda, wires.sda_levels), ("SCL", wires.scl, wires.scl_levels))
    low = [f"{name} (GPIO{pin})" for name, pin, levels in lines if not levels[1]]
    floating = [f"{name} (GPIO{pin})" for name, pin, levels in lines if levels == (0, 1)]
    if len(low) == 2:
        return failed_check(
            "wiring",
            f"both lines are held low: {' and '.join(low)}",
            "the sensor board has no supply: connect 3V3 to VIN or 3V, and GND to GND",
        )
    if low:
        return failed_check(
            "wiring",
            f"{low[0]} is held low",
            "power-cycle the board; if it persists: a short to GND or another pin, or a defective chip",
        )
    if floating:
        return failed_check(
            "wiring",
            f"no pull-up on {' and '.join(floating)}",
            "connect the sensor board; a bare chip needs 4.7 kΩ from SDA and from SCL to 3V3",
        )
    if wires.devices:
        return passed_check(
            "wiring",
            f"{names}, both pulled up; " + ", ".join(describe_device(*chip) for chip in wires.devices),
        )
    if wires.swapped_devices:
        addresses = ", ".join(f"0x{address:02X}" for address, _ in wires.swapped_devices)
        return failed_check(
            "wiring",
            f"SDA and SCL are exchanged: {addresses} answers with the lines swapped",
            f"connect SDA of the sensor board to GPIO{wires.sda} and SCL to GPIO{wires.scl}",
        )
    return failed_check(
        "wiring",
        f"{names}, both pulled up, but nothing answers",
        "check for wires on other pins, a chip in SPI mode (CS must be high), or a defective chip",
    )
