"""The radios of a board in the time of the ether: an nRF24L01+ on its pins, and ESP-NOW of an ESP32."""

from __future__ import annotations

from hubodo.emulator.board.ether import Ether
from hubodo.emulator.chips.espnow import EspNow
from hubodo.emulator.chips.nrf24 import Nrf24

CSN_PIN, CE_PIN = 17, 20


class RadioModule:
    """What hangs on a board's SPI, its select pin and its enable pin, and its own radio; times in ns."""

    def __init__(self, ether: Ether, mac: bytes) -> None:
        self._ether = ether
        self.chip = Nrf24(ether)
        self._own = EspNow(ether, mac)
        ether.join(self)

    def reached(self, t: float) -> None:
        """The board does nothing before t."""
        self._ether.reached(self, t)

    def end(self) -> None:
        """The board is switched off."""
        self.chip.silent = self._own.silent = True
        self._ether.leave(self)

    def pin(self, t: float, number: int, level: int) -> None:
        """A pin of the board is driven."""
        if number == CSN_PIN:
            self._ether.act(self, t, lambda: self._select(t, level))
        elif number == CE_PIN:
            self._ether.act(self, t, lambda: self._enable(t, level))

    def transfer(self, t: float, data: bytes) -> bytes:
        """Bytes out, as many in."""
        return self._ether.act(self, t, lambda: self.chip.transfer(t, data))

    def espnow(self, t: float, request: bytes) -> tuple[int, bytes]:
        """A call of ESP-NOW: (status, what it answers)."""
        return self._ether.act(self, t, lambda: self._own.call(t, request))

    def reset(self) -> None:
        """The processor restarts."""
        self._own.reset()

    def _select(self, t: float, level: int) -> bytes:
        self.chip.select(t, selected=not level)
        return b""

    def _enable(self, t: float, level: int) -> bytes:
        self.chip.enable(t, on=bool(level))
        return b""
