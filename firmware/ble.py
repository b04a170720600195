"""Bluetooth Low Energy: one host at a time; frames as notifications, requests as writes.

A notification for which the radio has no room is refused by an ESP32 (NimBLE), but stored on the heap without
limit by a Pico W (BTstack): the host therefore writes how many it has received, and at most _WINDOW are on
their way. Its first report, zero, says that it has subscribed. protocol/README.md has the service.
"""

import gc
from time import ticks_add, ticks_diff, ticks_ms

import bluetooth
import machine
from micropython import const
from packets import PacketLink

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

_SERVICE = "670ba625-1817-4787-999a-e477d288%04x"
_CENTRAL_CONNECT = const(1)
_CENTRAL_DISCONNECT = const(2)
_GATTS_WRITE = const(3)
_MTU_EXCHANGED = const(21)
_WRITE_NO_RESPONSE = const(0x04)
_WRITE = const(0x08)
_NOTIFY = const(0x10)
_MTU = const(247)
"""A notification of this size fits one packet of the link layer, with the extension of Bluetooth 4.2."""
_ATT_HEADER_BYTES = const(3)
_DEFAULT_PACKET_BYTES = const(20)
_MIN_PACKET_BYTES = const(61)
"""The handshake of the key takes up to 34 bytes, a sealed request up to 60."""
_WINDOW = const(12)
_MAX_IN_FLIGHT = const(14)
"""The window and two packets of a handshake, for which a busy link has room as well."""
_MAX_REQUESTS = const(8)
_ADVERTISING_US = const(100000)
_REFUSED_MS = const(5)
_SILENT_MS = const(5000)
_MIN_FREE_HEAP = const(8192)
"""Bytes. A Pico W stores up to nine notifications of the window there, 2.6 kB."""
_COUNT_MASK = const(0xFFFF)


class BleLink(PacketLink):
    """A link to the host that is connected; advertised while none is. `step` must be called every second."""

    def __init__(self, settings):
        super().__init__(_MTU - _ATT_HEADER_BYTES)
        self._connection = -1
        self._requests = []
        self._sent = self._reported = 0
        self._subscribed = self._advertising = self._heap_checked = False
        self._progress_ms = self._retry_ms = ticks_ms()
        self.packet_bytes = _DEFAULT_PACKET_BYTES
        self._ble: Any = bluetooth.BLE()
        ble = self._ble
        ble.active(True)
        ble.config(mtu=_MTU)
        ble.irq(self._on_event)
        uuids: Any = [bluetooth.UUID(_SERVICE % (0x8606 + i)) for i in range(4)]
        ((self._frames, self._writes, self._reports),) = ble.gatts_register_services(
            (
                (
                    uuids[0],
                    (
                        (uuids[1], _NOTIFY),
                        (uuids[2], _WRITE | _WRITE_NO_RESPONSE),
                        (uuids[3], _WRITE | _WRITE_NO_RESPONSE),
                    ),
                ),
            )
        )
        ble.gatts_set_buffer(self._writes, _MTU - _ATT_HEADER_BYTES)
        name = "hubodo-%d-%s" % (settings["node_id"], bytes(machine.unique_id())[-2:].hex())
        ble.config(gap_name=name)
        # Advertised are flags (general discovery, no classic Bluetooth) and the service; the name in the
        # response to a scan.
        self._advertised = b"\x02\x01\x06\x11\x07" + bytes(uuids[0])
        self._response = bytes((len(name) + 1, 9)) + name.encode()
        self._advertise()

    def _on_event(self, event, data):
        if event == _CENTRAL_CONNECT:
            self._connection = data[0]
            self._advertising = False
            self.connections += 1
            self.packet_bytes = _DEFAULT_PACKET_BYTES
            self._sent = self._reported = 0
            self._subscribed = False
            self._requests.clear()
            self._at = self._end
            self._progress_ms = ticks_ms()
        elif event == _CENTRAL_DISCONNECT and data[0] == self._connection:
            self._connection = -1
            self._advertise()
        elif event == _MTU_EXCHANGED and data[0] == self._connection:
            self.packet_bytes = data[1] - _ATT_HEADER_BYTES
        elif event == _GATTS_WRITE and data[0] == self._connection:
            value = self._ble.gatts_read(data[1])
            if data[1] == self._reports:
                self._on_report(value)
            elif len(self._requests) < _MAX_REQUESTS:
                self._requests.append(value)
            else:
                self.reader.damaged += 1

    def _on_report(self, value):
        """Handle the report of the number of notifications that the host has received, two bytes."""
        if len(value) == 2:
            count = value[0] | value[1] << 8
            if (self._sent - count & _COUNT_MASK) <= _MAX_IN_FLIGHT:
                self._subscribed = True
                self._reported = count
                self._progress_ms = ticks_ms()

    def _advertise(self):
        try:
            self._ble.gap_advertise(_ADVERTISING_US, adv_data=self._advertised, resp_data=self._response)
            self._advertising = True
        except OSError:
            # The next attempt follows in a second.
            pass

    def _in_flight(self):
        return self._sent - self._reported & _COUNT_MASK

    def _check_heap(self):
        """Refuse settings that leave too little heap; called once, when everything else is loaded."""
        self._heap_checked = True
        gc.collect()
        if gc.mem_free() < _MIN_FREE_HEAP:
            raise MemoryError("link ble needs 8 kB more heap: choose another filter_kind, bias_kind or link")

    def step(self):
        if not self._heap_checked:
            self._check_heap()
        if self._connection < 0:
            if not self._advertising:
                self._advertise()
        elif self._subscribed and not self._in_flight():
            self._progress_ms = ticks_ms()
        elif ticks_diff(ticks_ms(), self._progress_ms) >= _SILENT_MS:
            # This host does not read frames; another one may.
            self.drop()

    def close(self):
        self._ble.active(False)

    def drop(self):
        if self._connection >= 0:
            try:
                self._ble.gap_disconnect(self._connection)
            except OSError:
                # The connection is lost already.
                pass

    def is_open(self):
        return self._connection >= 0 and self._subscribed and self.packet_bytes >= _MIN_PACKET_BYTES

    def can_send(self):
        return self._has_room(_WINDOW)

    def _has_room(self, limit):
        if not self.is_open() or self._in_flight() >= limit:
            return False
        return ticks_diff(ticks_ms(), self._retry_ms) >= 0

    def send_packet(self, raw, at, size):
        if not self._has_room(_MAX_IN_FLIGHT):
            return False
        try:
            self._ble.gatts_notify(self._connection, self._frames, memoryview(raw)[at : at + size])
        except OSError:
            # The radio has no room, or the connection is lost.
            self._retry_ms = ticks_add(ticks_ms(), _REFUSED_MS)
            return False
        self._sent = self._sent + 1 & _COUNT_MASK
        return True

    def receive_packet(self, raw):
        if not self._requests:
            return 0
        value = self._requests.pop(0)
        raw[: len(value)] = value
        return len(value)
