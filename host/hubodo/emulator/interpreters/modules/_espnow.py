"""MicroPython's module espnow of the virtual board, as on the port esp32, with its errors."""

# Runs in MicroPython: without type annotations.
# mypy: ignore-errors

import struct

import _board

MAX_DATA_LEN = 250
ADDR_LEN = 6

_ACTIVE, _ADD_PEER, _REMOVE_PEER, _SEND, _RECEIVE, _STATS = range(6)
_ERROR_NAMES = ("NOT_INIT", "ARG", "NO_MEM", "FULL", "NOT_FOUND", "INTERNAL", "EXIST", "IF", "CHAN")
_ERROR_BASE = 0x3065

_device = open("/dev/espnow", "r+b")
_read_reply = _device.readinto
_write_request = _device.write


def _ask(call, data=b""):
    """Send a call to the board; return its status, or raise its error."""
    _write_request(bytes([call]) + bytes(data))
    status = _board.result()
    if status < 0:
        raise OSError(-_ERROR_BASE + 1 + status, "ESP_ERR_ESPNOW_" + _ERROR_NAMES[-status - 1])
    return status


def _address(mac):
    """Return a MAC address as bytes; raise ValueError if it is invalid."""
    if len(mac) != ADDR_LEN:
        raise ValueError("invalid buffer length")
    return bytes(mac)


class ESPNow:
    """ESP-NOW in the subset that the firmware uses."""

    def __init__(self):
        self._on = False
        self._rxbuf = 526
        self._raw = bytearray(7 + MAX_DATA_LEN)
        self._senders = {}

    def active(self, on=None):
        if on is not None:
            self._on = bool(on)
            _ask(_ACTIVE, struct.pack("<HH", self._on, self._rxbuf))
        return self._on

    def config(self, *names, rxbuf=None, timeout_ms=None, rate=None):
        if rxbuf is not None:
            self._rxbuf = rxbuf
        if names:
            raise ValueError("unknown config param")

    def add_peer(self, mac, lmk=None, channel=0, ifidx=0, encrypt=False):
        _ask(_ADD_PEER, _address(mac) + bytes([channel]))

    def del_peer(self, mac):
        _ask(_REMOVE_PEER, _address(mac))

    def send(self, mac, message, sync=True):
        if sync:
            raise NotImplementedError("nothing here waits for an answer")
        _ask(_SEND, _address(mac) + bytes(message))
        return True

    def recvinto(self, data, timeout_ms=None):
        if timeout_ms != 0:
            raise NotImplementedError("nothing here waits for a packet")
        if len(data[1]) != MAX_DATA_LEN:
            raise ValueError("invalid buffer length")
        size = _ask(_RECEIVE) - 7
        if size < 0:
            return 0
        raw = self._raw
        _read_reply(raw)
        mac = bytes(raw[:6])
        data[0] = self._senders.setdefault(mac, mac)
        if len(data) >= 4:
            data[2] = raw[6] - 256
        message = data[1]
        for k in range(size):
            message[k] = raw[7 + k]
        return size

    def stats(self):
        _ask(_STATS)
        raw = bytearray(20)
        _read_reply(raw)
        return struct.unpack("<5I", raw)
