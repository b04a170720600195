"""Foxglove's live protocol, spoken to by a plain WebSocket client: the topics of the log, its bytes."""

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

HERE = Address("127.0.0.1", 0)


class Client:
    """Speaks foxglove.sdk.v1: hears of channels, asks for all, and decodes their messages."""

    def __init__(self, port):
        self.connection = connect(
            f"ws://127.0.0.1:{port}",
            subprotocols=["foxglove.sdk.v1"],
            max_size=None,
            max_queue=None,
            open_timeout=300,
        )
        self.channels, self.asked, self.messages = {}, {}, []

    def __enter__(self):
        self.socket = self.connection.__enter__()
        return self

    def __exit__(self, *error):
        self.connection.__exit__(*error)

    def hear(self):
        said = self.socket.recv(timeout=300)
        if isinstance(said, bytes):
            opcode, subscription, t_ns = struct.unpack_from("<BIQ", said)
            assert opcode == 1
            channel = self.asked[subscription]
            self.messages.append((channel["topic"], t_ns, self.decoded(channel, said[13:])))
            return
        told = json.loads(said)
        if told["op"] == "advertise":
            fresh = {channel["id"]: channel for channel in told["channels"]}
            self.channels |= fresh
            self.asked |= fresh
            wish = [{"id": number, "channelId": number} for number in fresh]
            self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wish}))

    def decoded(self, channel, payload):
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


def write(sink, k):
    """What a recorder writes, number k."""
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


def test_a_client_is_told_of_every_topic_of_the_log_and_its_messages_decode(tmp_path):
    from hubodo.web.foxglove_live import FoxgloveLive

    with FoxgloveLive(HERE) as live, LogWriter(tmp_path / "x.mcap") as log, ExitStack() as stack:
        bulkheads = Bulkheads(time.time_ns)
        sink = TeeSink(log, live.attach(log, None, bulkheads), bulkheads)
        write(sink, 0)
        until(lambda: live.clients._channels and not live._thread.waiting_count)
        client = stack.enter_context(Client(live.clients.port))
        while client.topics() != TOPICS:
            client.hear()
        until(lambda: live.clients.has_subscribers)
        live._thread.put(None)
        turn = 0
        while {topic for topic, _, _ in client.messages} != TOPICS:
            turn += 1
            write(sink, turn)
            live._thread.put(None)  # as `poll` does fifty times a second
            client.hear()
        imu = next(message for topic, _, message in client.messages if topic == "/left/imu")
        assert imu.angular_velocity.x % 1.0 == 0.5
        assert imu.linear_acceleration.z == 9.8
        pose = next(message for topic, _, message in client.messages if topic == "/odom")
        assert (pose.pose.pose.position.y, pose.twist.twist.linear.x) == (2.0, 1.5)
        event = next(message for topic, _, message in client.messages if topic == "/hubodo/events")
        assert json.loads(event.data)["text"].startswith("number")


def test_a_log_is_played_to_a_client_message_by_message(tmp_path):
    from hubodo.web.foxglove_live import FoxgloveClients, FoxgloveReplay

    with LogWriter(tmp_path / "x.mcap", t_zero_ns=10**18) as log:
        for k in range(10):
            write(log, 10 * k)
    clients = FoxgloveClients(HERE)
    with open_log(tmp_path / "x.mcap") as log, ExitStack() as stack:
        played = FoxgloveReplay(clients, log, 10**18)
        client = stack.enter_context(Client(clients.port))
        while client.topics() != TOPICS:
            client.hear()
        until(lambda: sum(channel.has_sinks() for channel in clients._channels.values()) == 7)
        played.send_until(10**18 + 45_000_000)
        while len(client.messages) < 5 * 10:
            client.hear()
        rates = [m.angular_velocity.x for topic, _, m in client.messages if topic == "/left/imu"]
        assert rates == [0.5 + 10 * k for k in range(5) for _ in range(2)]
        assert max(t_ns for _, t_ns, _ in client.messages) <= 10**18 + 45_000_000
    clients.finish()


def test_it_is_for_this_computer_alone_and_says_so_when_it_is_not_installed(tmp_path, monkeypatch):
    from hubodo.web.foxglove_live import FoxgloveClients

    with pytest.raises(InputError, match="ssh -L"):
        FoxgloveClients(Address("0.0.0.0", 8765))
    monkeypatch.setitem(sys.modules, "foxglove", None)
    done = hubodo("record", "/dev/null", "-o", tmp_path / "x.mcap", "--foxglove")
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert "pip install 'hubodo[foxglove]'" in done.err
    assert list(tmp_path.iterdir()) == []


def test_playing_serves_the_clients_while_it_lasts(tmp_path):
    with LogWriter(tmp_path / "x.mcap", t_zero_ns=10**18) as log:
        for k in range(10):
            write(log, 10 * k)
    done = hubodo("play", tmp_path / "x.mcap", "--speed", 0, "--foxglove", "127.0.0.1:0", "--json")
    assert done.code == 0 and "Foxglove: open connection ws://127.0.0.1:" in done.err
    done = hubodo("play", tmp_path / "x.mcap", "--to", "pty", "--foxglove")
    assert done.code == 2 and "--foxglove" in done.err
