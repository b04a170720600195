"""MicroPython's module bluetooth of the virtual board: a GATT server with the refusals of its ports.

Events are delivered after each sleep, as a port delivers them between bytecodes.
"""

# Runs in MicroPython: without type annotations.
# mypy: ignore-errors

import struct
import time

import _board

FLAG_READ = 0x0002
FLAG_WRITE_NO_RESPONSE = 0x0004
FLAG_WRITE = 0x0008
FLAG_NOTIFY = 0x0010

_ACTIVE, _ADVERTISE, _REGISTER, _NOTIFY, _DISCONNECT, _EVENTS, _SET_MTU = range(7)
_GATTS_WRITE = 3
_DEFAULT_BUFFER_BYTES = 20
_MAX_ADVERTISED_BYTES = 31
_ENODEV, _EINVAL = 19, 22

_device = open("/dev/ble", "r+b")
_poll = bytes([_EVENTS])
_packet = bytearray(5 + 517)
"""Reused, as this MicroPython collects no garbage while its program runs."""


def _ask(call, data=b""):
    """Send a call to the board; return its status, or raise its error."""
    _device.write(bytes([call]) + bytes(data))
    status = _board.result()
    if status < 0:
        raise OSError(-status)
    return status


class UUID:
    """A UUID of 128 bits; its bytes are in little-endian order, as on the air."""

    def __init__(self, value):
        digits = value.replace("-", "")
        if len(digits) != 32:
            raise ValueError("invalid UUID")
        raw = bytes.fromhex(digits)
        self._raw = bytes(raw[15 - i] for i in range(16))

    def __bytes__(self):
        return self._raw

    def __iter__(self):
        return iter(self._raw)


class _Value:
    """The value of a characteristic: the buffer that a remote write replaces or extends."""

    def __init__(self):
        self.data, self.size, self.append = b"", _DEFAULT_BUFFER_BYTES, False


class BLE:
    """The Bluetooth radio, a singleton, in the subset that the firmware uses."""

    _one = None

    def __new__(cls):
        if cls._one is None:
            cls._one = object.__new__(cls)
            cls._one._on = False
            cls._one._handler = None
            cls._one._values = {}
            cls._one._mtu, cls._one._name = 256, b"MPY"
            time.after_sleep.append(cls._one._deliver)
        return cls._one

    def active(self, on=None):
        if on is not None and bool(on) != self._on:
            _ask(_ACTIVE, bytes([bool(on)]))
            self._on = bool(on)
            self._values.clear()
        return self._on

    def _check_active(self):
        if not self._on:
            raise OSError(_ENODEV)

    def config(self, *names, **values):
        self._check_active()
        for name in names:
            if name == "mtu":
                return self._mtu
            if name == "gap_name":
                return self._name
            raise ValueError("unknown config param")
        for name in values:
            if name == "mtu":
                if not 23 <= values[name] <= 517:
                    raise OSError(_EINVAL)
                self._mtu = values[name]
                _ask(_SET_MTU, struct.pack("<H", self._mtu))
            elif name == "gap_name":
                self._name = values[name]
            else:
                raise ValueError("unknown config param")
        return None

    def irq(self, handler):
        if handler is not None and not callable(handler):
            raise ValueError("invalid handler")
        self._handler = handler

    def gap_advertise(self, interval_us, adv_data=None, *, resp_data=None, connectable=True):
        self._check_active()
        adv, resp = bytes(adv_data or b""), bytes(resp_data or b"")
        if len(adv) > _MAX_ADVERTISED_BYTES or len(resp) > _MAX_ADVERTISED_BYTES:
            raise OSError(_EINVAL)
        _ask(_ADVERTISE, struct.pack("<IB", interval_us or 0, len(adv)) + adv + resp)

    def gatts_register_services(self, services):
        self._check_active()
        handles = []
        for uuid, characteristics in services:
            request = bytes(uuid) + bytes([len(characteristics)])
            for characteristic in characteristics:
                request += bytes(characteristic[0]) + bytes([characteristic[1]])
            _ask(_REGISTER, request)
            raw = bytearray(2 * len(characteristics))
            _device.readinto(raw)
            handles.append(struct.unpack("<%dH" % len(characteristics), raw))
        for row in handles:
            for handle in row:
                self._values[handle] = _Value()
        return tuple(handles)

    def _value(self, handle):
        self._check_active()
        if handle not in self._values:
            raise OSError(_EINVAL)
        return self._values[handle]

    def gatts_set_buffer(self, handle, size, append=False):
        value = self._value(handle)
        value.data, value.size, value.append = b"", size, append

    def gatts_read(self, handle):
        value = self._value(handle)
        data = value.data
        if value.append:
            value.data = b""
        return data

    def gatts_write(self, handle, data, send_update=False):
        self._value(handle).data = bytes(data)

    def gatts_notify(self, connection, handle, data=None):
        value = self._value(handle)
        data = value.data if data is None else data
        struct.pack_into("<BHH", _packet, 0, _NOTIFY, connection, handle)
        _packet[5 : 5 + len(data)] = data
        _device.write(_packet, 5 + len(data))
        if _board.result() < 0:
            raise OSError(-_board.result())

    def gap_disconnect(self, connection):
        self._check_active()
        return not _ask(_DISCONNECT, struct.pack("<H", connection))

    def _deliver(self):
        """Call the handler for the events since the last sleep."""
        if not self._on:
            return
        _device.write(_poll)
        size = _board.result()
        if size <= 0:
            return
        raw = bytearray(size)
        _device.readinto(raw)
        at = 0
        while at < size:
            event, connection, number, length = struct.unpack_from("<BHHH", raw, at)
            at += 7
            if event == _GATTS_WRITE:
                value = self._values[number]
                before = value.data if value.append else b""
                value.data = (before + bytes(raw[at : at + length]))[: value.size]
            at += length
            if self._handler is not None:
                self._handler(event, (connection, number))
