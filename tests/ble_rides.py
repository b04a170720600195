"""Two nodes by Bluetooth to one host, all in virtual time on one air of `BleConditions`."""

import asyncio
from dataclasses import dataclass, field

import numpy as np
from bumble.device import Peer

import hubowire
from hubodo.emulator.board.radio_medium import RadioMedium
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host
from hubodo.emulator.chips.ble_peripheral import BleAir, BlePeripheral
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.ingest.link.sealed import DatagramSealer
from hubowire import messages as m
from hubowire.ble import FRAMES_UUID, REPORT_INTERVAL, REPORTS_UUID, REQUESTS_UUID, encode_report
from virtual_runs import FIRMWARE, count_missing_frames, unique_motion

HOST_DELAY_S = 0.01
"""Assumed time from a packet until the host's report reaches its radio: system bus and event loop."""
REQUEST_INTERVAL_S = 1.0
SETTLED_S = 5.0
"""Time after power-on at which both nodes are connected and their queues are empty again."""


@dataclass
class KeyTable:
    """Keys by serial, as `DatagramSealer` reads them."""

    keys: dict


@dataclass
class Stream:
    """The frames received of one node, (time in s, frame, message), and (time, bytes) of all packets."""

    sent: list = field(default_factory=list)
    packets: list = field(default_factory=list)

    def after(self, t):
        return [(frame, message) for at, frame, message in self.sent if at >= t]

    def delays(self, t):
        """Return the delays in s from the last sample of each batch to its reception."""
        return np.array(
            [
                at - message.t_us * 1e-6 - (len(message.samples) - 1) * message.period_ns * 1e-9
                for at, _, message in self.sent
                if at >= t and isinstance(message, m.ImuBatch)
            ]
        )

    def bytes_per_s(self, t, end):
        return sum(size for at, size in self.packets if at >= t) / (end - t)


@dataclass
class Ride:
    """The streams of both nodes, and the counters of the air."""

    streams: dict
    counts: dict
    seconds: float

    def lost(self, k):
        """Return the frames of a node that are missing once the connection has settled."""
        return count_missing_frames(self.streams[k].after(SETTLED_S))


async def receive(air, device, connecting, address, stream, key, mtu):
    """Connect to a node, prove the key and receive frames, as `ingest.link.ble` does."""
    async with connecting:
        connection = await device.connect(address, timeout=None)
    peer = Peer(connection)
    await peer.request_mtu(mtu)
    await peer.discover_services()
    values = {}
    for service in peer.services:
        await service.discover_characteristics()
        values |= {one.uuid.to_hex_str("-").lower(): one for one in service.characteristics}
    sealer = DatagramSealer(KeyTable({"node": key}))
    decoder, count = hubowire.FrameDecoder(), 0

    async def write(uuid, data):
        await values[uuid].write_value(data, with_response=False)

    def on_packet(data):
        nonlocal count
        count += 1
        opened = sealer.open(bytes(data), "node")
        if opened.answer:
            air.loop.call_later(
                HOST_DELAY_S, lambda: asyncio.ensure_future(write(REQUESTS_UUID, opened.answer))
            )
        if count % REPORT_INTERVAL == 0:
            report = encode_report(count)
            air.loop.call_later(HOST_DELAY_S, lambda: asyncio.ensure_future(write(REPORTS_UUID, report)))
        now = air.loop.time()
        stream.packets.append((now, len(data)))
        stream.sent += [
            (now, frame, hubowire.decode(frame.type_id, frame.payload))
            for frame in decoder.feed(opened.frames)
        ]

    await values[FRAMES_UUID].subscribe(on_packet)
    await values[REPORTS_UUID].write_value(encode_report(0), with_response=True)
    ping = b"\0" + hubowire.encode_frame(hubowire.Frame(m.Ping.type_id, hubowire.ANY_NODE, 0, b""))
    while True:
        await asyncio.sleep(REQUEST_INTERVAL_S)
        sealed = sealer.seal(ping, "node")
        if sealed is not None:
            await write(REQUESTS_UUID, sealed[0])


async def host(air, streams, key, mtu):
    """Receive from both nodes; the controller connects to one after the other."""
    _, device = air.create_device("F0:00:00:00:00:01", "host")
    await device.power_on()
    connecting = asyncio.Lock()
    await asyncio.gather(
        *(receive(air, device, connecting, address, stream, key, mtu) for address, stream in streams)
    )


def ride(conditions, *, mtu=247, rate_hz=416, seconds=8.0, seed=1, models=("pico_w", "esp32")):
    """Run two nodes with keys for a time; return what their host received."""
    air, key = BleAir(conditions, seed), bytes(range(32))
    medium = RadioMedium(open_bluetooth=lambda mac, port: BlePeripheral(air, mac, port))
    streams = {k: Stream() for k in (1, 2)}
    addresses = [(f"E6:61:41:{k:02X}:00:00", streams[k]) for k in streams]
    task = air.loop.create_task(host(air, addresses, key, mtu))
    nodes = [
        VirtualNode(
            unique_motion(seconds),
            Flash(
                FIRMWARE,
                {"link": "ble", "node_id": k, "rate_hz": rate_hz, "batch": 16, "key": key.hex()},
            ),
            board=BoardSettings(
                interpreter="cpython", model=models[k - 1], unique_id=f"e66141{k:02x}000000{k:02x}"
            ),
            clock=Clock("stepped", run_for=seconds),
            host=Host("memory"),
            own_process=False,
            radio_medium=medium,
        )
        for k in streams
    ]
    try:
        for node in nodes:
            node.start()
        for node in nodes:
            node.wait(200)
            assert node.stats["resets"] == []
    finally:
        for node in nodes:
            node.stop()
    if task.done():
        raise task.exception()
    task.cancel()
    air.loop.run_until(seconds + 1.0)
    return Ride(streams, dict(air.counts), seconds)
