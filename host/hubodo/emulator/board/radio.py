"""Radios of a board on the shared medium: an nRF24L01+ on its pins, ESP-NOW of an ESP32, and Bluetooth."""

from __future__ import annotations

from hubodo.emulator.board.hypercall import ENODEV
from hubodo.emulator.board.radio_medium import RadioMedium
from hubodo.emulator.chips.espnow import EspNow
from hubodo.emulator.chips.nrf24 import Nrf24

CSN_PIN, CE_PIN = 17, 20


class RadioModule:
    """The nRF24L01+ on SPI, chip select and chip enable of a board, its ESP-NOW station and its Bluetooth.

    Times are in ns.
    """

    def __init__(self, medium: RadioMedium, mac: bytes, platform: str) -> None:
        self._medium = medium
        self._bluetooth = None if medium.open_bluetooth is None else medium.open_bluetooth(mac, platform)
        self.chip = Nrf24(medium)
        self._espnow = EspNow(medium, mac)
        medium.add_board(self)

    def advance(self, t: float) -> None:
        """Declare that the board does nothing before t."""
        self._medium.advance(self, t)

    def switch_off(self) -> None:
        """Remove the board from the medium."""
        self.chip.switched_off = self._espnow.switched_off = True
        self._medium.remove_board(self)

    def set_pin(self, t: float, number: int, level: int) -> None:
        """Set the level of a pin of the board."""
        if number == CSN_PIN:
            self._medium.run_in_order(self, t, lambda: self._select(t, level))
        elif number == CE_PIN:
            self._medium.run_in_order(self, t, lambda: self._enable(t, level))

    def transfer(self, t: float, data: bytes) -> bytes:
        """Exchange bytes on SPI."""
        return self._medium.run_in_order(self, t, lambda: self.chip.transfer(t, data))

    def call_espnow(self, t: float, request: bytes) -> tuple[int, bytes]:
        """Handle a call of ESP-NOW; return status and result."""
        return self._medium.run_in_order(self, t, lambda: self._espnow.handle_call(t, request))

    def call_bluetooth(self, t: float, request: bytes) -> tuple[int, bytes]:
        """Handle a call of the module bluetooth; return status and result."""
        bluetooth = self._bluetooth
        if bluetooth is None:
            return -ENODEV, b""
        return self._medium.run_in_order(self, t, lambda: bluetooth.handle_call(t, request))

    def reset(self) -> None:
        """Reset ESP-NOW and Bluetooth, as at a restart of the processor."""
        self._espnow.reset()
        if self._bluetooth is not None:
            self._bluetooth.reset()

    def _select(self, t: float, level: int) -> bytes:
        """Set the chip select of the nRF24L01+, active low."""
        self.chip.select(t, selected=not level)
        return b""

    def _enable(self, t: float, level: int) -> bytes:
        """Set the chip enable of the nRF24L01+."""
        self.chip.enable(t, on=bool(level))
        return b""
