"""Links by Bluetooth: names, keys, and what is refused with which remedy."""

import threading
import time

import pytest

from fakes.fake_bluez import FakeBlueZ
from hubodo.emulator.chips.ble_link import BleConditions
from hubodo.emulator.chips.ble_peripheral import BleAir, BleCall, BlePeripheral
from hubodo.errors import InputError, LinkError
from hubodo.ingest.link import ble
from hubodo.ingest.link.open_link import LinkDown
from hubodo.ingest.link.ports import attach_keys, parse_port
from hubowire.ble import FRAMES_UUID, REPORTS_UUID, REQUESTS_UUID, SERVICE_UUID

NAME = b"hubodo-1-2d2f"
ADVERTISED = b"\x02\x01\x06\x11\x07" + bytes.fromhex(SERVICE_UUID.replace("-", ""))[::-1]


class RunningAir(BleAir):
    """An air whose time a thread advances, and a node on it that a test controls."""

    def __init__(self):
        super().__init__(BleConditions(), seed=1)
        self._lock, self._stopping = threading.Lock(), False
        self.node = BlePeripheral(self, b"\0\1\2\3\4\5", "rp2")
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        while not self._stopping:
            self.call(BleCall.EVENTS, keep=True)
            time.sleep(0.001)

    events = b""

    def call(self, call, data=b"", *, keep=False):
        with self._lock:
            status, reply = self.node.handle_call((self.loop.now + 0.005) * 1e9, bytes([call]) + data)
            if keep:
                self.events += reply
            return status, reply

    def start(self):
        self._thread.start()
        return self

    def advertise(self):
        self.call(BleCall.ACTIVE, b"\1")
        uuids = [bytes.fromhex(u.replace("-", ""))[::-1] for u in (FRAMES_UUID, REQUESTS_UUID, REPORTS_UUID)]
        rows = b"".join(uuid + bytes([flags]) for uuid, flags in zip(uuids, (0x10, 0x0C, 0x0C), strict=True))
        self.call(BleCall.REGISTER, ADVERTISED[5:] + b"\3" + rows)
        response = bytes([len(NAME) + 1, 9]) + NAME
        self.call(
            BleCall.ADVERTISE,
            (100_000).to_bytes(4, "little") + bytes([len(ADVERTISED)]) + ADVERTISED + response,
        )

    def stop(self):
        self._stopping = True
        self._thread.join(5)


@pytest.fixture
def air(monkeypatch):
    monkeypatch.setattr(ble, "_SEARCH_S", 0.5)
    running = RunningAir()
    running.bluez = FakeBlueZ(running, monkeypatch)
    running.start()
    yield running
    running.stop()


def test_a_port_names_a_node_and_requires_keys_or_an_option(tmp_path):
    port = parse_port("left=ble://hubodo-1-2d2f")
    assert (port.kind, port.target, port.label) == ("ble", "hubodo-1-2d2f", "left")
    for text in ("ble://", "ble://a b"):
        with pytest.raises(InputError, match="ble://hubodo-1"):
            parse_port(text)
    with pytest.raises(InputError, match=r"nearby.*--key-file.*--insecure-ble"):
        attach_keys(port, None, insecure=("udp",))
    assert attach_keys(port, None, insecure=("ble",)).keys is None


@pytest.mark.parametrize("wanted", ["hubodo-1", "HUBODO-1-2D2F", "aa:bb:cc:00:11:22"])
def test_a_node_is_named_by_id_by_board_or_by_address(wanted):
    assert ble.matches(wanted, "hubodo-1-2d2f", "AA:BB:CC:00:11:22")
    assert not ble.matches(wanted, "hubodo-12-2d2f", "AA:BB:CC:00:11:23")
    assert not ble.matches("hubodo", "hubodo-1-2d2f", "")


def test_a_computer_without_bluez_gets_the_remedy(monkeypatch):
    """bleak itself, not the fake: the socket of the system bus is missing."""
    monkeypatch.setenv("DBUS_SYSTEM_BUS_ADDRESS", "unix:path=/nowhere/system_bus_socket")
    with pytest.raises(LinkError, match=r"ble://hubodo-1: .*no Bluetooth service; sudo apt install bluez"):
        ble.BleTransport("hubodo-1")


def test_an_adapter_that_is_off_and_a_node_that_does_not_advertise_are_named(air):
    air.bluez.powered = False
    with pytest.raises(LinkError, match=r"Turn on Bluetooth.*`hubodo doctor`"):
        ble.BleTransport("hubodo-1")
    air.bluez.powered = True
    with pytest.raises(LinkError, match="no node is in reach"):
        ble.BleTransport("hubodo-1")
    air.advertise()
    with pytest.raises(LinkError, match=r"hubodo-2: not advertised; in reach: hubodo-1-2d2f"):
        ble.BleTransport("hubodo-2")


def test_a_connection_passes_packets_on_in_both_directions_and_reports_its_end(air):
    air.advertise()
    link = ble.BleTransport("hubodo-1")
    try:
        link.write(b"request")
        deadline = time.monotonic() + 5
        while b"request" not in air.events and time.monotonic() < deadline:
            time.sleep(0.01)
        assert b"request" in air.events
        connection, frames = air.node._connection.handle, next(iter(air.node._characteristics))
        head = connection.to_bytes(2, "little") + frames.to_bytes(2, "little")
        for k in range(8):
            assert air.call(BleCall.NOTIFY, head + bytes([k]) * 200)[0] == 0
        assert [link.read(5)[0] for _ in range(8)] == [bytes([k]) * 200 for k in range(8)]
        assert link.read(0.01) == (b"", "")
        air.call(BleCall.DISCONNECT, head[:2])
        with pytest.raises(LinkDown, match=r"connection lost$"):
            link.read(5)
    finally:
        link.close()
