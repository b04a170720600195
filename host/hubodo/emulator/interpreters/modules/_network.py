"""MicroPython's module network of the virtual board: a WLAN interface with the behaviour of its port."""

# Runs in MicroPython: without type annotations.
# mypy: ignore-errors

import _board

STA_IF = 0
AP_IF = 1
_IS_ESP32 = _board.platform() == "esp32"
STAT_IDLE = 1000 if _IS_ESP32 else 0
STAT_CONNECTING = 1001 if _IS_ESP32 else 1
STAT_GOT_IP = 1010 if _IS_ESP32 else 3


def country(code=None):
    return code


def hostname(name=None):
    return name


class WLAN:
    """The WLAN station."""

    IF_STA = 0
    IF_AP = 1
    PM_NONE = 0

    def __init__(self, interface=STA_IF):
        self._on = False

    def active(self, on=None):
        if on is not None:
            self._on = bool(on)
            _board.wlan(1 if on else 0)
        return self._on

    def config(self, *names, **values):
        for name in values:
            if name == "reconnects" and _IS_ESP32:
                _board.wlan(0x101 + values[name])
            elif name != "pm" and not (name == "channel" and _IS_ESP32):
                raise ValueError("unknown config param")

    def connect(self, ssid=None, key=None, **options):
        if _board.wlan(2) < 0:
            raise OSError("Wifi Internal State Error" if _IS_ESP32 else -1)

    def disconnect(self):
        _board.wlan(3)

    def isconnected(self):
        return _board.wlan(5) == 1

    def status(self, what=None):
        if what == "rssi":
            return -50
        return _board.wlan(4)

    def ifconfig(self, setting=None):
        return ("127.0.0.1", "255.0.0.0", "127.0.0.1", "10.0.0.1")
