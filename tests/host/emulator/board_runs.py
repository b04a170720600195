"""Programs run to their end on the virtual board in virtual time; returns their output."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from board_programs import firmware

from hubodo.emulator.board.settings import Clock, Flash, Host
from hubodo.emulator.motion import RecordedMotion, StillMotion
from hubodo.emulator.virtual_node import VirtualNode

EMPTY, CLOCK = Flash(), Clock()
WHO = """
import machine
i2c = machine.I2C(0, scl=machine.Pin(5), sda=machine.Pin(4), freq=400000)
print(i2c.readfrom_mem(0x6B, 0x0F, 1)[0], i2c.scan())
"""


def turning() -> RecordedMotion:
    t = np.arange(0, 300, 0.01)
    return RecordedMotion(
        t,
        np.stack([np.sin(t), np.cos(3 * t), 5 * np.sin(0.2 * t)], 1),
        np.stack([9 * np.cos(t), t % 7, -t % 5], 1),
    )


def run(
    tmp_path: Path,
    main: str,
    seconds: float = 5.0,
    motion: Any = None,
    *,
    flash: Flash = EMPTY,
    clock: Clock = CLOCK,
    **options: Any,
) -> VirtualNode:
    """A started node whose virtual time has run out."""
    node = VirtualNode(
        motion or StillMotion(),
        replace(flash, firmware=firmware(tmp_path / "fw", main=main)),
        clock=replace(clock, kind="stepped", run_for=seconds),
        host=Host("memory"),
        own_process=False,
        **options,
    )
    node.start()
    assert node.wait(300)
    return node


def printed(node: VirtualNode) -> list[str]:
    lines = node.output.decode().split("\r\nMicroPython v")[0].split("\r\nCPython")[0].replace("\r", "")
    node.stop()
    return lines.splitlines()
