"""Foxglove's live protocol, tested with a plain WebSocket client: topics and messages of the log."""

import json
import struct
import sys
import time
from contextlib import ExitStack

import numpy as np
import pytest
from mcap.records import Schema
from websockets.sync.client import connect

import wanted
from hubodo.errors import InputError
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.tee_sink import TeeSink
from hubodo.log.log_writer import LogWriter
from hubodo.log.logfile import open_log
from hubodo.log.records import EventRecord, ImuBlock, NmeaBytes, Odometry, RawFrame, Transform
from hubodo.recording import Event
from hubodo.web.address import Address
from in_process import hubodo
from waiting import until

wanted.module("foxglove")
Ros2 = wanted.module("mcap_ros2.decoder").DecoderFactory

LOOPBACK = Address("127.0.0.1", 0)


class Client:
    """A client for foxglove.sdk.v1 that subscribes to all advertised channels and decodes their messages."""

    def __init__(self, port):
        self.connection = connect(
            f"ws://127.0.0.1:{port}",
            subprotocols=["foxglove.sdk.v1"],
            max_size=None,
            max_queue=None,
            open_timeout=300,
        )
        self.channels, self.subscriptions, self.messages = {}, {}, []

    def __enter__(self):
        self.socket = self.connection.__enter__()
        return self

    def __exit__(self, *error):
        self.connection.__exit__(*error)

    def receive(self):
        data = self.socket.recv(timeout=300)
        if isinstance(data, bytes):
            opcode, subscription, t_ns = struct.unpack_from("<BIQ", data)
            assert opcode == 1
            channel = self.subscriptions[subscription]
            self.messages.append((channel["topic"], t_ns, self.decode(channel, data[13:])))
            return
        message = json.loads(data)
        if message["op"] == "advertise":
            new_channels = {channel["id"]: channel for channel in message["channels"]}
            self.channels |= new_channels
            self.subscriptions |= new_channels
            subscriptions = [{"id": number, "channelId": number} for number in new_channels]
            self.socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))

    def decode(self, channel, payload):
        if channel["encoding"] != "cdr":
            return payload
        schema = Schema(
            id=1,
            name=channel["schemaName"],
            encoding=channel["schemaEncoding"],
            data=channel["schema"].encode(),
        )
        return Ros2().decoder_for("cdr", schema)(payload)

    def topics(self):
        return {channel["topic"] for channel in self.channels.values()}


def write_records(sink, k):
    """Write the k-th set of records of a recorder."""
    t_ns = np.array([k, k + 1], np.int64) * 1_000_000 + 10**18
    now, position, zeros = int(t_ns[0]), np.array([[k, 2.0]] * 2), np.zeros(2)
    imu = ImuBlock("left", np.full((2, 3), 0.5 + k), np.full((2, 3), 9.8), 25.0, now, t_ns=t_ns, t_log_ns=now)
    sink.write_record(imu)
    sink.write_record(Odometry(t_ns, now, position, zeros, zeros + 1.5, zeros + 0.1))
    sink.write_record(Transform(t_ns, now, position, zeros))
    sink.write_record(RawFrame("left", now, b"\x01\x02\x00"))
    sink.write_record(EventRecord(Event(now, "mark", "user", f"number {k}")))
    sink.write_record(NmeaBytes(now, b"$GP"))


TOPICS = {
    "/left/imu",
    "/left/temperature",
    "/odom",
    "/tf",
    "/hubodo/raw/left",
    "/hubodo/events",
    "/gnss/nmea",
}


def test_every_topic_of_the_log_is_advertised_and_its_messages_can_be_decoded(tmp_path):
    from hubodo.web.foxglove_live import FoxgloveLive

    with FoxgloveLive(LOOPBACK) as live, LogWriter(tmp_path / "x.mcap") as log, ExitStack() as stack:
        bulkheads = Bulkheads(time.time_ns)
        sink = TeeSink(log, live.attach(log, None, bulkheads), bulkheads)
        write_records(sink, 0)
        until(lambda: live.clients._channels and not live._thread.waiting_count)
        client = stack.enter_context(Client(live.clients.port))
        while client.topics() != TOPICS:
            client.receive()
        until(lambda: live.clients.has_subscribers)
        live._thread.put(None)
        turn = 0
        while {topic for topic, _, _ in client.messages} != TOPICS:
            turn += 1
            write_records(sink, turn)
            live._thread.put(None)  # as `poll` does fifty times per second
            client.receive()
        imu = next(message for topic, _, message in client.messages if topic == "/left/imu")
        assert imu.angular_velocity.x % 1.0 == 0.5
        assert imu.linear_acceleration.z == 9.8
        pose = next(message for topic, _, message in client.messages if topic == "/odom")
        assert (pose.pose.pose.position.y, pose.twist.twist.linear.x) == (2.0, 1.5)
        event = next(message for topic, _, message in client.messages if topic == "/hubodo/events")
        assert json.loads(event.data)["text"].startswith("number")


def test_a_log_is_replayed_to_a_client_message_by_message(tmp_path):
    from hubodo.web.foxglove_live import FoxgloveClients, FoxgloveReplay

    with LogWriter(tmp_path / "x.mcap", t_zero_ns=10**18) as log:
        for k in range(10):
            write_records(log, 10 * k)
    clients = FoxgloveClients(LOOPBACK)
    with open_log(tmp_path / "x.mcap") as log, ExitStack() as stack:
        replay = FoxgloveReplay(clients, log, 10**18)
        client = stack.enter_context(Client(clients.port))
        while client.topics() != TOPICS:
            client.receive()
        until(lambda: sum(channel.has_sinks() for channel in clients._channels.values()) == 7)
        replay.send_until(10**18 + 45_000_000)
        while len(client.messages) < 5 * 10:
            client.receive()
        rates = [m.angular_velocity.x for topic, _, m in client.messages if topic == "/left/imu"]
        assert rates == [0.5 + 10 * k for k in range(5) for _ in range(2)]
        assert max(t_ns for _, t_ns, _ in client.messages) <= 10**18 + 45_000_000
    clients.finish()


def test_foxglove_listens_on_loopback_only_and_names_its_extra_if_missing(tmp_path, monkeypatch):
    from hubodo.web.foxglove_live import FoxgloveClients

    with pytest.raises(InputError, match="ssh -L"):
        FoxgloveClients(Address("0.0.0.0", 8765))
    monkeypatch.setitem(sys.modules, "foxglove", None)
    done = hubodo("record", "/dev/null", "-o", tmp_path / "x.mcap", "--foxglove")
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert "pip install 'hubodo[foxglove]'" in done.err
    assert list(tmp_path.iterdir()) == []


def test_play_serves_foxglove_until_its_end(tmp_path):
    with LogWriter(tmp_path / "x.mcap", t_zero_ns=10**18) as log:
        for k in range(10):
            write_records(log, 10 * k)
    done = hubodo("play", tmp_path / "x.mcap", "--speed", 0, "--foxglove", "127.0.0.1:0", "--json")
    assert done.code == 0 and "Foxglove: open connection ws://127.0.0.1:" in done.err
    done = hubodo("play", tmp_path / "x.mcap", "--to", "pty", "--foxglove")
    assert done.code == 2 and "--foxglove" in done.err
