"""A link by Bluetooth Low Energy, through bleak (extra `ble`)."""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
from collections import Counter
from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any, TypeVar

from hubodo.errors import LinkError
from hubodo.ingest.link.open_link import WRITE_TIMEOUT_S, LinkDown
from hubowire.ble import (
    FRAMES_UUID,
    NAME_PREFIX,
    REPORT_INTERVAL,
    REPORTS_UUID,
    REQUESTS_UUID,
    SERVICE_UUID,
    encode_report,
)

if TYPE_CHECKING:
    from bleak import BleakClient
    from bleak.backends.device import BLEDevice
    from bleak.backends.scanner import AdvertisementData

_SEARCH_S, _CONNECT_S, _DISCONNECT_S = 6.0, 15.0, 3.0
_CONNECTING = threading.Lock()
"""Held while a link connects: BlueZ refuses to connect to one device while it connects to another."""
Result = TypeVar("Result")


class BleTransport:
    """The connection to one node that advertises a name; a stream of frames, or of sealed packets.

    bleak needs an event loop, which a thread of the link runs.
    """

    datagrams = False

    def __init__(self, name: str) -> None:
        """Search for the node and connect; raise LinkError with the remedy."""
        self.endpoint = f"ble://{name}"
        self.refused: Counter[str] = Counter()
        self._name = name
        self._received: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._count = 0
        self._client: BleakClient | None = None
        self._reporting: asyncio.Task[None] | None = None
        self._loop = asyncio.new_event_loop()
        self._report_due = asyncio.Event()
        self._thread = threading.Thread(target=self._loop.run_forever, name=self.endpoint, daemon=True)
        self._thread.start()
        try:
            with _CONNECTING:
                self._wait_for(self._connect(), _SEARCH_S + _CONNECT_S)
        except BaseException as error:
            self.close()
            if isinstance(error, (OSError, EOFError, TimeoutError)) or _is_of_bleak(error):
                raise LinkError(f"{self.endpoint}: {_describe(error)}") from error
            raise

    def read(self, timeout: float) -> tuple[bytes, str]:
        try:
            packet = self._received.get(timeout=timeout)
        except queue.Empty:
            return b"", ""
        if packet is None:
            self._received.put(None)
            known = "" if self._count else " before any frame: another key, or a host with an MTU below 64"
            raise LinkDown(f"{self.endpoint}: connection lost{known}")
        return packet, ""

    def write(self, data: bytes, to: str = "") -> None:
        """Send one packet; a connection that is lost meanwhile is reported by `read`."""
        client = self._client
        if client is not None:
            with contextlib.suppress(Exception):
                self._wait_for(client.write_gatt_char(REQUESTS_UUID, data, response=False), WRITE_TIMEOUT_S)

    def close(self) -> None:
        # The connection may be lost, or the system's service gone: there is nothing left to release then.
        with contextlib.suppress(Exception):
            self._wait_for(self._disconnect(), _DISCONNECT_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_DISCONNECT_S)

    async def _disconnect(self) -> None:
        if self._reporting is not None:
            self._reporting.cancel()
        client, self._client = self._client, None
        if client is not None:
            await client.disconnect()

    def _wait_for(self, coroutine: Coroutine[Any, Any, Result], timeout: float) -> Result:
        """Return the result of a coroutine of the loop; raise TimeoutError after `timeout` seconds."""
        future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result(timeout)
        except TimeoutError:
            future.cancel()
            raise

    async def _connect(self) -> None:
        from bleak import BleakClient

        device = await self._find_node()
        client = BleakClient(device, lambda _: self._received.put(None), services=[SERVICE_UUID])
        await client.connect()
        self._client = client
        if client.services.get_characteristic(REPORTS_UUID) is None:
            raise LinkError(f"{self.endpoint}: is not a node of this version; flash it again")
        await client.start_notify(FRAMES_UUID, self._on_packet)
        await client.write_gatt_char(REPORTS_UUID, encode_report(0), response=True)
        self._reporting = asyncio.get_running_loop().create_task(self._report())

    async def _find_node(self) -> BLEDevice:
        """Return the device that advertises the name; raise LinkError without one."""
        from bleak import BleakScanner

        names: set[str] = set()

        def is_wanted(device: BLEDevice, advertised: AdvertisementData) -> bool:
            name = advertised.local_name or device.name or ""
            if name:
                names.add(name)
            return matches(self._name, name, device.address)

        device = await BleakScanner.find_device_by_filter(is_wanted, _SEARCH_S, service_uuids=[SERVICE_UUID])
        if device is None:
            nodes = sorted(name for name in names if name.startswith(NAME_PREFIX))
            others = f"in reach: {', '.join(nodes)}" if nodes else "no node is in reach"
            raise LinkError(
                f"{self.endpoint}: not advertised; {others}; a node that another host is connected to does "
                "not advertise"
            )
        return device

    def _on_packet(self, _: object, data: bytearray) -> None:
        self._received.put(bytes(data))
        self._count += 1
        if self._count % REPORT_INTERVAL == 0:
            self._report_due.set()

    async def _report(self) -> None:
        """Report the number of packets received, so that the node sends more."""
        while (client := self._client) is not None:
            await self._report_due.wait()
            self._report_due.clear()
            try:
                await client.write_gatt_char(REPORTS_UUID, encode_report(self._count), response=False)
            except Exception:  # noqa: BLE001 a backend may raise anything; without reports the node disconnects
                return


def matches(wanted: str, name: str, address: str) -> bool:
    """Return True if a node is the wanted one: by address, full name, or name without the board's digits."""
    wanted = wanted.lower()
    return wanted in (address.lower(), name.lower(), name.lower().rpartition("-")[0])


def _is_of_bleak(error: BaseException) -> bool:
    return type(error).__module__.startswith("bleak")


def _describe(error: BaseException) -> str:
    """Return an error of the system's Bluetooth with its remedy."""
    if isinstance(error, FileNotFoundError):
        return "this computer has no Bluetooth service; sudo apt install bluez, then start it"
    if isinstance(error, TimeoutError):
        return "the node does not answer; move closer, or restart it"
    text = " ".join(str(error).split()) or type(error).__name__
    return f"{text}; `hubodo doctor` checks adapter and rights"
