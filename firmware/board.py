"""The board: bus, link, watchdog, battery and identity, on the pins of `pins.py` or of /config.json."""

import os
import sys
import time

import machine
from micropython import const

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_BUS_HZ = const(400000)
_WATCHDOG_MS = const(8000)


class Hardware:
    """The hardware of a node, opened according to its settings."""

    def __init__(self, settings):
        name = getattr(sys.implementation, "_machine", "")
        self.kind, self.pins, self.reset_cause = _identity(name, settings["link"])
        self.pins.update(settings["pins"])
        self.settings = settings
        self.serial = (bytes(machine.unique_id()) + bytes(8))[:8]
        self.boot_id = _random_u16()
        self.i2c = self._bus()
        self._watchdog = None
        self._battery: Any = None
        if self.pins["battery_enable"] >= 0 and self.pins["battery"] >= 0:
            machine.Pin(self.pins["battery_enable"], machine.Pin.OUT, value=1)
        if self.pins["battery"] >= 0:
            self._battery = machine.ADC(machine.Pin(self.pins["battery"]))
        self._knows_volts = hasattr(self._battery, "read_uv")
        if self._knows_volts:
            # The full scale of an ESP32's ADC is 0.95 V unless attenuated.
            self._battery.atten(self._battery.ATTN_11DB)

    def battery_mv(self):
        """Return the supply voltage, 0 where it is not measured."""
        if self._battery is None:
            return 0
        factor = self.pins["battery_factor"]
        if self._knows_volts:
            return self._battery.read_uv() * factor // 1000
        return self._battery.read_u16() * (3300 * factor) >> 16

    def start_watchdog(self, is_required):
        """Start the watchdog: `feed` must be called every 8 s from here on; only a reset stops it."""
        if is_required or self.settings["watchdog"]:
            self._watchdog = machine.WDT(timeout=_WATCHDOG_MS)

    def feed(self):
        if self._watchdog is not None:
            self._watchdog.feed()

    def has_watchdog(self):
        return self._watchdog is not None

    def free_bus(self):
        """Release a chip that holds SDA by nine clocks and a stop; return True if the bus is free then."""
        sda = machine.Pin(self.pins["sda"], machine.Pin.OPEN_DRAIN, value=1)
        scl = machine.Pin(self.pins["scl"], machine.Pin.OPEN_DRAIN, value=1)
        for _ in range(9):
            scl.value(0)
            time.sleep_us(5)
            scl.value(1)
            time.sleep_us(5)
        sda.value(0)
        time.sleep_us(5)
        sda.value(1)
        time.sleep_us(5)
        free = sda.value() == 1
        self.i2c = self._bus()
        return free

    def open_link(self):
        """Return the link that the settings name."""
        from link_choice import open_link

        del sys.modules["link_choice"]
        return open_link(self)

    def _bus(self):
        pins = self.pins
        return machine.I2C(
            pins["i2c"], scl=machine.Pin(pins["scl"]), sda=machine.Pin(pins["sda"]), freq=_BUS_HZ
        )


def _identity(name, link):
    """Return (Board, pins, ResetCause); modules needed at the start alone are unloaded to save memory."""
    from pins import WITH_RADIO, board_of
    from reset_cause import reset_cause

    kind, pins = board_of(name)
    if link in "udp ble" and kind in WITH_RADIO:
        # The radio uses the pin of the battery.
        pins["battery"] = -1
    cause = reset_cause(name)
    del sys.modules["pins"], sys.modules["reset_cause"]
    return kind, pins, cause


def _random_u16():
    try:
        raw = os.urandom(2)
        return raw[0] | raw[1] << 8
    except AttributeError:
        import random

        return random.getrandbits(16)
