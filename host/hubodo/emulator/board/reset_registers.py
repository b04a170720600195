"""What a board remembers of its last reset: the port's cause, and on an RP2 the two registers behind it."""

from __future__ import annotations

from typing import Literal

from hubodo.emulator.board.models import BoardModel

Why = Literal["power-on", "reset pin", "brown-out", "machine.reset", "watchdog"]

_PWRON, _HARD, _WDT = 1, 2, 3
# ports/rp2/modmachine.c: anything but the watchdog is power-on, and machine.reset is the watchdog's doing.
# ports/esp32/modmachine.c: esp_restart is a hard reset; a pulled EN pin looks like power-on to an ESP32.
_CAUSES: dict[str, dict[Why, int]] = {
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
_REASON: dict[Why, int] = {"machine.reset": 2, "watchdog": 1}
# (address of WATCHDOG REASON, of CHIP_RESET, bits there), from the data sheets of the two processors.
_RP2040 = (0x40058008, 0x40064008, {"power-on": 1 << 8, "brown-out": 1 << 8, "reset pin": 1 << 16})
_RP2350 = (0x400D8008, 0x4010002C, {"power-on": 1 << 16, "brown-out": 1 << 17, "reset pin": 1 << 18})


class ResetRegisters:
    """Of one board, from its power-on on."""

    def __init__(self, model: BoardModel) -> None:
        self._model = model
        self._last: Why = "power-on"
        self._chip_level: Why = "power-on"

    def reset(self, why: Why) -> None:
        """A reset has happened; what the watchdog does leaves the record of the chip's own resets alone."""
        self._last = why
        if why not in _REASON:
            self._chip_level = why

    def as_config(self) -> dict[str, object]:
        """reset_cause, and the registers by their address in hex."""
        registers: dict[str, int] = {}
        if self._model.platform == "rp2":
            reason, chip_reset, bits = _RP2040 if self._model.machine.endswith("RP2040") else _RP2350
            registers = {f"{reason:x}": _REASON.get(self._last, 0), f"{chip_reset:x}": bits[self._chip_level]}
        return {"reset_cause": _CAUSES[self._model.platform][self._last], "registers": registers}
