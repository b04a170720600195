"""Cause of the last reset of a board: the code of the port, and the registers of an RP2 behind it."""

from __future__ import annotations

from typing import Literal

from hubodo.emulator.board.models import BoardModel

ResetCause = Literal["power-on", "reset pin", "brown-out", "machine.reset", "watchdog"]

_PWRON, _HARD, _WDT = 1, 2, 3
# ports/rp2/modmachine.c: every cause but the watchdog is power-on, and machine.reset uses the watchdog.
# ports/esp32/modmachine.c: esp_restart is a hard reset; the EN pin counts as power-on.
_CAUSE_CODES: dict[str, dict[ResetCause, int]] = {
    "rp2": {
        "power-on": _PWRON,
        "reset pin": _PWRON,
        "brown-out": _PWRON,
        "machine.reset": _WDT,
        "watchdog": _WDT,
    },
    "esp32": {
        "power-on": _PWRON,
        "reset pin": _PWRON,
        "brown-out": _PWRON,
        "machine.reset": _HARD,
        "watchdog": _WDT,
    },
}
_WATCHDOG_REASON: dict[ResetCause, int] = {"machine.reset": 2, "watchdog": 1}
# (Address of WATCHDOG REASON, address of CHIP_RESET, its bits), from the data sheets of both processors.
_RP2040 = (0x40058008, 0x40064008, {"power-on": 1 << 8, "brown-out": 1 << 8, "reset pin": 1 << 16})
_RP2350 = (0x400D8008, 0x4010002C, {"power-on": 1 << 16, "brown-out": 1 << 17, "reset pin": 1 << 18})


class ResetRegisters:
    """Reset cause of one board since power-on."""

    def __init__(self, model: BoardModel) -> None:
        self._model = model
        self._last_cause: ResetCause = "power-on"
        self._chip_cause: ResetCause = "power-on"

    def reset(self, cause: ResetCause) -> None:
        """Record a reset; a watchdog reset leaves the record of chip-level resets unchanged."""
        self._last_cause = cause
        if cause not in _WATCHDOG_REASON:
            self._chip_cause = cause

    def as_config(self) -> dict[str, object]:
        """Return `reset_cause`, and the registers by address in hexadecimal."""
        registers: dict[str, int] = {}
        if self._model.platform == "rp2":
            reason, chip_reset, bits = _RP2040 if self._model.machine.endswith("RP2040") else _RP2350
            registers = {
                f"{reason:x}": _WATCHDOG_REASON.get(self._last_cause, 0),
                f"{chip_reset:x}": bits[self._chip_cause],
            }
        return {"reset_cause": _CAUSE_CODES[self._model.platform][self._last_cause], "registers": registers}
