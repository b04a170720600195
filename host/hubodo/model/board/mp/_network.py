"""network of the virtual board: a station that is on the air as soon as it is told to connect."""

# MicroPython's own types: not the host's code, no host types.
# mypy: ignore-errors

import _board

STA_IF = 0
AP_IF = 1
STAT_IDLE = 0
STAT_CONNECTING = 1
STAT_GOT_IP = 3


def country(code=None):
    return code


def hostname(name=None):
    return name


class WLAN:
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
        return None

    def connect(self, ssid=None, key=None, **options):
        if not self._on:
            raise OSError(5)
        _board.wlan(2)

    def disconnect(self):
        _board.wlan(3)

    def isconnected(self):
        return _board.wlan(4) == 1

    def status(self, what=None):
        if what == "rssi":
            return -50
        return STAT_GOT_IP if self.isconnected() else STAT_IDLE

    def ifconfig(self, setting=None):
        return ("127.0.0.1", "255.0.0.0", "127.0.0.1", "127.0.0.1")
