"""A fake backend of bleak, in place of BlueZ: a stack of bumble on the air of virtual boards.

It refuses what bleak's backend for BlueZ refuses: calls while the adapter is off, a device that has vanished,
calls without a connection, writes without response beyond the MTU. Its coroutines run in the loop of the air,
whose time is that of the boards; bleak's own front end runs unchanged in the loop of its caller.
"""

import asyncio

import bleak
from bleak.backends.characteristic import BleakGATTCharacteristic
from bleak.backends.client import BaseBleakClient
from bleak.backends.scanner import AdvertisementData, BaseBleakScanner
from bleak.backends.service import BleakGATTService, BleakGATTServiceCollection
from bleak.exc import (
    BleakBluetoothNotAvailableError,
    BleakBluetoothNotAvailableReason,
    BleakDBusError,
    BleakDeviceNotFoundError,
    BleakError,
)
from bleak.uuids import normalize_uuid_str
from bumble.core import AdvertisingData
from bumble.device import Peer

MTU = 517
"""What BlueZ offers in an exchange."""
_WRITE_HEADER_BYTES = 3


class FakeBlueZ:
    """One adapter on an air; `powered`: False if it is switched off."""

    def __init__(self, air, monkeypatch):
        self.air, self.powered = air, True
        self.central = None
        self.advertised = {}
        backend = {"scanner": self._bind(FakeScanner), "client": self._bind(FakeClient)}
        for kind, its_type in backend.items():
            monkeypatch.setattr(
                bleak, f"get_platform_{kind}_backend_type", lambda its_type=its_type: (its_type, "fake")
            )
        air.loop.create_task(self._power_on())

    def _bind(self, its_type):
        return type(its_type.__name__, (its_type,), {"adapter": self})

    async def _power_on(self):
        _, self.central = self.air.create_device("F0:00:00:00:00:01", "host")
        await self.central.power_on()

    async def call(self, coroutine):
        """Return the result of a coroutine of the air, in the loop of the caller."""
        return await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(coroutine, self.air.loop))

    def check_powered(self):
        if not self.powered:
            raise BleakBluetoothNotAvailableError(
                "No powered Bluetooth adapters report. Turn on Bluetooth and try again.",
                BleakBluetoothNotAvailableReason.POWERED_OFF,
            )


def text_of(uuid):
    """Return a UUID as bleak writes it."""
    return normalize_uuid_str(uuid.to_hex_str("-"))


class FakeScanner(BaseBleakScanner):
    adapter: FakeBlueZ

    def __init__(self, detection_callback, service_uuids, scanning_mode, **_):
        super().__init__(detection_callback, service_uuids)
        self._merged = {}

    async def start(self):
        self.adapter.check_powered()
        self._caller = asyncio.get_running_loop()
        await self.adapter.call(self._scan())

    async def _scan(self):
        self.adapter.central.on("advertisement", self._on_advertisement)
        await self.adapter.central.start_scanning(active=True)

    async def stop(self):
        await self.adapter.call(self._stop())

    async def _stop(self):
        self.adapter.central.remove_listener("advertisement", self._on_advertisement)
        await self.adapter.central.stop_scanning()

    def _on_advertisement(self, report):
        """Merge what a device advertises with its response to the scan, as BlueZ does."""
        address = str(report.address).split("/")[0]
        self.adapter.advertised[address] = report.address
        uuids, name = self._merged.get(address, ([], None))
        uuids = report.data.get(AdvertisingData.COMPLETE_LIST_OF_128_BIT_SERVICE_CLASS_UUIDS) or uuids
        name = report.data.get(AdvertisingData.COMPLETE_LOCAL_NAME) or name
        self._merged[address] = uuids, name
        data = AdvertisementData(name, {}, {}, [text_of(uuid) for uuid in uuids], None, report.rssi, ())
        self._caller.call_soon_threadsafe(self._detect, address, name, data)

    def _detect(self, address, name, data):
        if self.is_allowed_uuid(data.service_uuids):
            device = self.create_or_update_device(address, address, name, None, data)
            self.call_detection_callbacks(device, data)


class FakeClient(BaseBleakClient):
    adapter: FakeBlueZ

    def __init__(self, device, **options):
        super().__init__(device, **options)
        self._connection = self._peer = None
        self._proxies = {}

    @property
    def name(self):
        return self.address

    @property
    def mtu_size(self):
        return 23 if self._connection is None else self._connection.att_mtu

    @property
    def is_connected(self):
        return self._connection is not None

    async def connect(self, pair, **_):
        self.adapter.check_powered()
        if self._connection is not None:
            raise BleakError("Client is already connected")
        if self.address not in self.adapter.advertised:
            raise BleakDeviceNotFoundError(
                self.address, f"Device with address {self.address} was not report."
            )
        self._caller = asyncio.get_running_loop()
        await self.adapter.call(self._connect())

    async def _connect(self):
        connection = await self.adapter.central.connect(
            self.adapter.advertised[self.address], timeout=self._timeout
        )
        self._connection = connection
        connection.on(connection.EVENT_DISCONNECTION, self._on_disconnection)
        self._peer = Peer(connection)
        await self._peer.request_mtu(MTU)
        self.services = BleakGATTServiceCollection()
        await self._peer.discover_services()
        for service in self._peer.services:
            await service.discover_characteristics()
            ours = BleakGATTService(None, service.handle, text_of(service.uuid))
            self.services.add_service(ours)
            for one in service.characteristics:
                names = [name.lower().replace("_", "-") for name in one.properties.name.split("|")]
                self._proxies[one.handle] = one
                self.services.add_characteristic(
                    BleakGATTCharacteristic(
                        None, one.handle, text_of(one.uuid), names, lambda: self.mtu_size - 3, ours
                    )
                )

    def _on_disconnection(self, reason):
        self._connection = None
        if self._disconnected_callback is not None:
            self._caller.call_soon_threadsafe(self._disconnected_callback)

    async def disconnect(self):
        if self._connection is not None:
            await self.adapter.call(self._connection.disconnect())

    async def write_gatt_char(self, characteristic, data, response):
        if self._connection is None:
            raise BleakError("Not connected")
        if not response and len(data) > self.mtu_size - _WRITE_HEADER_BYTES:
            raise BleakDBusError("org.bluez.Error.Failed", ["Failed to initiate write"])
        proxy = self._proxies[characteristic.handle]
        await self.adapter.call(proxy.write_value(bytes(data), with_response=response))

    async def start_notify(self, characteristic, callback, **_):
        if self._connection is None:
            raise BleakError("Not connected")

        def receive(value):
            self._caller.call_soon_threadsafe(callback, bytearray(value))

        await self.adapter.call(self._proxies[characteristic.handle].subscribe(receive))

    async def stop_notify(self, characteristic):
        raise NotImplementedError("no link stops notifications without disconnecting")

    async def pair(self, *_, **__):
        raise NotImplementedError("a link authenticates by its own key")

    unpair = read_gatt_char = read_gatt_descriptor = write_gatt_descriptor = pair
