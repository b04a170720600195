"""The Bluetooth radio of a board: calls of the module `bluetooth` on a stack of bumble.

Refusals follow extmod/btstack and extmod/nimble of MicroPython: a port with BTstack (rp2) stores
notifications that its radio has no room for on the heap, without limit; one with NimBLE (esp32) refuses them
by ENOMEM. Neither asks whether the host has subscribed. Assumed: room for three packets on rp2, as configured
there, and twelve on esp32. Not modelled: pairing, more than one connection, reads by the host.
"""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Callable, Coroutine
from enum import IntEnum
from random import Random
from typing import Any

from bumble import att, gatt, hci
from bumble.controller import Controller
from bumble.core import UUID
from bumble.device import AdvertisingType, Connection, Device
from bumble.host import Host
from bumble.transport.common import AsyncPipeSink

from hubodo.emulator.chips.ble_link import BleConditions, PacedLink, VirtualTimeLoop

EINVAL, ENODEV, ENOMEM, ENOTCONN = 22, 19, 12, 107
ROOM_PACKETS = {"rp2": 3, "esp32": 12}
_MAX_EVENT_BYTES = 4096
_UUID_BYTES = 16
_STEPS_TO_QUEUE = 4
"""Steps of the loop until a notification is in the queue of its controller."""


class BleCall(IntEnum):
    """Calls of the module; the first byte of a request."""

    ACTIVE = 0
    ADVERTISE = 1
    REGISTER = 2
    NOTIFY = 3
    DISCONNECT = 4
    EVENTS = 5
    SET_MTU = 6


class BleEvent(IntEnum):
    """Events of MicroPython's module bluetooth."""

    CENTRAL_CONNECT = 1
    CENTRAL_DISCONNECT = 2
    GATTS_WRITE = 3
    MTU_EXCHANGED = 21


class BleAir:
    """The air that boards and hosts share, and the loop of their stacks."""

    def __init__(self, conditions: BleConditions, seed: int) -> None:
        self.loop = VirtualTimeLoop()
        self.link = PacedLink(conditions, Random(seed))
        self.counts: Counter[str] = self.link.counts

    def create_device(self, address: str, name: str) -> tuple[Controller, Device]:
        """Create a controller on the air, and a stack of bumble on it."""
        controller = Controller(name, link=self.link)
        device = Device(
            name=name, address=hci.Address(address), host=Host(controller, AsyncPipeSink(controller))
        )
        return controller, device

    def run(self, coroutine: Coroutine[Any, Any, Any]) -> None:
        """Run a coroutine that waits for answers of its own controller alone."""
        self.loop.run_until_complete(coroutine)


class BlePeripheral:
    """The Bluetooth radio of one board."""

    def __init__(self, air: BleAir, mac: bytes, platform: str) -> None:
        self._air, self._platform = air, platform
        # A static random address begins with two set bits.
        self._address = ":".join(f"{byte:02X}" for byte in (mac[0] | 0xC0, *mac[1:]))
        self._controller: Controller | None = None
        self._clear()

    def reset(self) -> None:
        """Clear everything, as at a restart of the processor: a host notices it by the silence."""
        if self._controller is not None:
            self._air.link.remove_controller(self._controller)
            self._controller = None
        self._clear()

    def _clear(self) -> None:
        self._device: Device | None = None
        self._connection: Connection | None = None
        self._characteristics: dict[int, gatt.Characteristic[bytes]] = {}
        self._events: deque[bytes] = deque()

    def handle_call(self, t: float, request: bytes) -> tuple[int, bytes]:
        """Handle a call at t in ns; return a status, negative for a refusal, and the result."""
        self._air.loop.run_until(t * 1e-9)
        call, data = request[0], request[1:]
        if call == BleCall.ACTIVE:
            self.reset()
            if data[0]:
                self._air.run(self._power_on())
            return 0, b""
        device = self._device
        if device is None:
            return -ENODEV, b""
        if call == BleCall.EVENTS:
            return self._take_events()
        if call == BleCall.ADVERTISE:
            self._air.run(self._advertise(device, data))
            return 0, b""
        if call == BleCall.REGISTER:
            handles = self._register(device, data)
            return len(handles), struct.pack(f"<{len(handles)}H", *handles)
        if call == BleCall.SET_MTU:
            (device.gatt_server.max_mtu,) = struct.unpack("<H", data)
            return 0, b""
        connection = self._connection
        if connection is None or connection.handle != struct.unpack_from("<H", data)[0]:
            return -ENOTCONN, b""
        if call == BleCall.DISCONNECT:
            self._air.loop.create_task(connection.disconnect())
            return 0, b""
        if call == BleCall.NOTIFY:
            return self._notify(device, connection, data), b""
        return -EINVAL, b""

    async def _power_on(self) -> None:
        self._controller, self._device = self._air.create_device(self._address, self._address)
        self._device.on(self._device.EVENT_CONNECTION, self._on_connection)
        await self._device.power_on()

    async def _advertise(self, device: Device, data: bytes) -> None:
        """Advertise from now on, or stop for an interval of zero."""
        interval_us, size = struct.unpack_from("<IB", data)
        if device.is_advertising:
            await device.stop_advertising()
        if interval_us:
            await device.start_advertising(
                AdvertisingType.UNDIRECTED_CONNECTABLE_SCANNABLE,
                advertising_data=data[5 : 5 + size],
                scan_response_data=data[5 + size :],
                advertising_interval_min=interval_us / 1000,
                advertising_interval_max=interval_us / 1000,
            )

    def _register(self, device: Device, data: bytes) -> list[int]:
        """Register a service; return the handles of its values."""
        uuids = [data[:_UUID_BYTES]]
        flags, at = [], _UUID_BYTES + 1
        for _ in range(data[_UUID_BYTES]):
            uuids.append(data[at : at + _UUID_BYTES])
            flags.append(data[at + _UUID_BYTES])
            at += _UUID_BYTES + 1
        characteristics = [
            gatt.Characteristic[bytes](
                UUID.from_bytes(uuid),
                gatt.Characteristic.Properties(flag),
                att.Attribute.Permissions.WRITEABLE,
                gatt.CharacteristicValue(write=self._writer(k)),
            )
            for k, (uuid, flag) in enumerate(zip(uuids[1:], flags, strict=True))
        ]
        device.add_service(gatt.Service(UUID.from_bytes(uuids[0]), characteristics))
        self._characteristics = {one.handle: one for one in characteristics}
        return list(self._characteristics)

    def _writer(self, k: int) -> Callable[[Any, bytes], None]:
        """Return the function that reports writes to the characteristic k."""

        def write(_: Any, value: bytes) -> None:
            handle = list(self._characteristics)[k]
            if self._connection is not None:
                self._report(BleEvent.GATTS_WRITE, self._connection.handle, handle, value)

        return write

    def _on_connection(self, connection: Connection) -> None:
        self._connection = connection
        self._report(BleEvent.CENTRAL_CONNECT, connection.handle)

        def lose(reason: int) -> None:
            self._connection = None
            self._report(BleEvent.CENTRAL_DISCONNECT, connection.handle)

        def change_mtu() -> None:
            self._report(BleEvent.MTU_EXCHANGED, connection.handle, connection.att_mtu)

        connection.on(connection.EVENT_DISCONNECTION, lose)
        connection.on(connection.EVENT_CONNECTION_ATT_MTU_UPDATE, change_mtu)

    def _report(self, event: BleEvent, connection: int, number: int = 0, data: bytes = b"") -> None:
        self._events.append(struct.pack("<BHHH", event, connection, number, len(data)) + data)

    def _take_events(self) -> tuple[int, bytes]:
        """Return the size of the reply, and the reply: as many whole events as fit."""
        reply = b""
        while self._events and len(reply) + len(self._events[0]) <= _MAX_EVENT_BYTES:
            reply += self._events.popleft()
        return len(reply), reply

    def _notify(self, device: Device, connection: Connection, data: bytes) -> int:
        """Queue a notification; return the status."""
        (handle,) = struct.unpack_from("<H", data, 2)
        characteristic = self._characteristics.get(handle)
        if characteristic is None:
            return -EINVAL
        assert self._controller is not None
        counts, queued = self._air.counts, self._air.link.queued_pieces(self._controller)
        if queued >= ROOM_PACKETS[self._platform]:
            if self._platform == "esp32":
                counts["refused"] += 1
                return -ENOMEM
            counts["stored on heap, most"] = max(
                counts["stored on heap, most"], queued + 1 - ROOM_PACKETS[self._platform]
            )
        self._air.loop.create_task(device.notify_subscriber(connection, characteristic, data[4:], force=True))
        for _ in range(_STEPS_TO_QUEUE):
            self._air.loop.run_until(self._air.loop.now)
        return 0
