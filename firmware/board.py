"""The board: pins by sys.platform (or as /config.json says), bus, link, watchdog, battery, identity."""

import os
import sys
import time

import machine
from micropython import const
from wire import (
    BOARD_ESP32,
    BOARD_OTHER,
    BOARD_RP2,
    RESET_CAUSE_HARD,
    RESET_CAUSE_POWER_ON,
    RESET_CAUSE_SOFT,
    RESET_CAUSE_UNKNOWN,
    RESET_CAUSE_WATCHDOG,
)

_BUS_HZ = const(400000)
_WATCHDOG_MS = const(8000)
_UART_BUFFER = const(512)

# battery: ADC pin, or -1; battery_factor: supply over ADC voltage.
_RP2_PINS = {"i2c": 0, "sda": 4, "scl": 5, "uart": 0, "tx": 0, "rx": 1, "battery": 29, "battery_factor": 3}
_ESP32_PINS = {
    "i2c": 0,
    "sda": 21,
    "scl": 22,
    "uart": 2,
    "tx": 17,
    "rx": 16,
    "battery": 35,
    "battery_factor": 2,
}
_BOARDS = {"rp2": (BOARD_RP2, _RP2_PINS), "esp32": (BOARD_ESP32, _ESP32_PINS)}

# Not every port has every one of these names.
_RESET_CAUSES = (
    ("PWRON_RESET", RESET_CAUSE_POWER_ON),
    ("HARD_RESET", RESET_CAUSE_HARD),
    ("WDT_RESET", RESET_CAUSE_WATCHDOG),
    ("SOFT_RESET", RESET_CAUSE_SOFT),
)


class Board:
    """The node's hardware, made from its settings."""

    def __init__(self, settings):
        self.kind, pins = _BOARDS.get(sys.platform, (BOARD_OTHER, _RP2_PINS))
        self.pins = dict(pins)
        if settings["link"] == "udp" and self.kind == BOARD_RP2:
            # On a Pico W this pin belongs to the radio.
            self.pins["battery"] = -1
        self.pins.update(settings["pins"])
        self.settings = settings
        self.serial = (bytes(machine.unique_id()) + bytes(8))[:8]
        self.boot_id = _random_u16()
        self.reset_cause = _reset_cause()
        self.i2c = self._bus()
        self._watchdog = None
        self._battery = None
        if self.pins["battery"] >= 0:
            self._battery = machine.ADC(machine.Pin(self.pins["battery"]))
        self._battery_full_mv = 3300 * self.pins["battery_factor"]

    def battery_mv(self):
        """Supply voltage, 0 when it is not measured."""
        if self._battery is None:
            return 0
        return self._battery.read_u16() * self._battery_full_mv >> 16

    def start_watchdog(self):
        """From here on `feed` must come at least every eight seconds; there is no way back but a reset."""
        if self.settings["watchdog"]:
            self._watchdog = machine.WDT(timeout=_WATCHDOG_MS)

    def feed(self):
        if self._watchdog is not None:
            self._watchdog.feed()

    def has_watchdog(self):
        return self._watchdog is not None

    def free_bus(self):
        """Nine clocks and a stop let go a chip that holds SDA; True when it is free then."""
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
        """The link that the settings name."""
        import link

        kind = self.settings["link"]
        if kind == "uart":
            return self._open_uart()
        if kind == "udp":
            import wifi

            return wifi.UdpLink(self.settings)
        if self.kind == BOARD_ESP32:
            import uart

            return uart.ConsoleLink()
        return link.UsbLink()

    def _open_uart(self):
        import uart

        baud, pins = self.settings["baud"], self.pins
        port = machine.UART(
            pins["uart"],
            baud,
            tx=machine.Pin(pins["tx"]),
            rx=machine.Pin(pins["rx"]),
            txbuf=_UART_BUFFER,
            rxbuf=_UART_BUFFER,
            timeout=0,
        )
        return uart.UartLink(port, baud, _UART_BUFFER)

    def _bus(self):
        pins = self.pins
        return machine.I2C(
            pins["i2c"], scl=machine.Pin(pins["scl"]), sda=machine.Pin(pins["sda"]), freq=_BUS_HZ
        )


def _reset_cause():
    cause = machine.reset_cause()
    for name, code in _RESET_CAUSES:
        if cause == getattr(machine, name, None):
            return code
    return RESET_CAUSE_UNKNOWN


def _random_u16():
    try:
        raw = os.urandom(2)
        return raw[0] | raw[1] << 8
    except AttributeError:
        import random

        return random.getrandbits(16)
