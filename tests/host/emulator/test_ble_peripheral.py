"""The fake Bluetooth radio of a board refuses what MicroPython's ports refuse, and its air takes its time."""

import asyncio
import struct

import pytest

from hubodo.emulator.chips.ble_link import BleConditions, VirtualTimeLoop
from hubodo.emulator.chips.ble_peripheral import (
    EINVAL,
    ENODEV,
    ENOMEM,
    ENOTCONN,
    ROOM_PACKETS,
    BleAir,
    BleCall,
    BleEvent,
    BlePeripheral,
)

UUIDS = [bytes(range(k, k + 16)) for k in range(2)]


def call(radio, what, data=b"", t=0.0):
    return radio.handle_call(t * 1e9, bytes([what]) + data)


@pytest.fixture(params=["rp2", "esp32"])
def radio(request):
    return BlePeripheral(BleAir(BleConditions(interval=0.05), seed=1), b"\0\1\2\3\4\5", request.param)


def connect(radio, mtu=247):
    """Connect a host to the radio; return the prefix of a notification and the time."""
    air = radio._air
    call(radio, BleCall.ACTIVE, b"\1")
    call(radio, BleCall.SET_MTU, struct.pack("<H", mtu))
    status, handles = call(radio, BleCall.REGISTER, UUIDS[0] + b"\1" + UUIDS[1] + b"\x10")
    assert status == 1
    call(radio, BleCall.ADVERTISE, struct.pack("<IB", 100_000, 3) + b"\2\1\6")

    async def host():
        _, device = air.create_device("F0:00:00:00:00:01", "host")
        await device.power_on()
        await device.connect(radio._address)

    task = air.loop.create_task(host())
    call(radio, BleCall.EVENTS, t=1.0)
    assert task.done() and task.exception() is None
    return struct.pack("<H", radio._connection.handle) + handles


def test_calls_are_refused_in_the_wrong_state(radio):
    for what in (BleCall.ADVERTISE, BleCall.REGISTER, BleCall.NOTIFY, BleCall.EVENTS):
        assert call(radio, what)[0] == -ENODEV, "the radio is not active"
    call(radio, BleCall.ACTIVE, b"\1")
    assert call(radio, BleCall.NOTIFY, b"\1\0\1\0x")[0] == -ENOTCONN
    assert call(radio, BleCall.DISCONNECT, b"\1\0")[0] == -ENOTCONN
    assert call(radio, 99)[0] == -ENOTCONN
    prefix = connect(radio)
    assert call(radio, BleCall.NOTIFY, prefix[:2] + b"\xff\xffx")[0] == -EINVAL


def test_without_room_one_port_refuses_and_the_other_stores_on_the_heap(radio):
    prefix = connect(radio)
    statuses = [call(radio, BleCall.NOTIFY, prefix + bytes(20), t=1.0)[0] for _ in range(20)]
    counts = radio._air.counts
    if radio._platform == "esp32":
        assert statuses.count(-ENOMEM) == counts["refused"] == 20 - ROOM_PACKETS["esp32"]
    else:
        assert statuses == [0] * 20 and counts["stored on heap, most"] == 20 - ROOM_PACKETS["rp2"]


def test_a_host_out_of_reach_is_reported_as_disconnected_after_the_supervision_timeout():
    conditions = BleConditions(interval=0.05, outages=((2.0, 9.0),), supervision_timeout=1.0)
    radio = BlePeripheral(BleAir(conditions, seed=1), b"\0\1\2\3\4\5", "rp2")
    prefix = connect(radio)
    call(radio, BleCall.NOTIFY, prefix + b"x", t=1.5)
    assert call(radio, BleCall.EVENTS, t=2.9) == (0, b"")
    _, events = call(radio, BleCall.EVENTS, t=3.2)
    assert events[0] == BleEvent.CENTRAL_DISCONNECT


def test_the_loop_runs_what_is_due_and_never_waits():
    loop, calls = VirtualTimeLoop(), []

    async def tick():
        while True:
            await asyncio.sleep(10.0)
            calls.append(loop.time())

    task = loop.create_task(tick())
    loop.run_until(1000.5)
    assert calls == pytest.approx([10.0 * k for k in range(1, 101)]) and loop.time() == 1000.5
    task.cancel()
    loop.run_until(1001.0)
    loop.run_until(1001.0)


def test_air_time_is_that_of_the_specification():
    """An empty packet lasts 80 us at 1 Mb/s, one of 251 bytes 2088 us, at 2 Mb/s 1048 us."""
    assert BleConditions().air_time(0) == pytest.approx(80e-6)
    assert BleConditions().air_time(251) == pytest.approx(2088e-6)
    assert BleConditions(phy=2).air_time(251) == pytest.approx(1048e-6)
