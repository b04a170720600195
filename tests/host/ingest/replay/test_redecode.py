"""Decoding the raw frames of a log reproduces samples, times, gaps and causes."""

import json
from operator import itemgetter

import numpy as np
import pytest

from fakes.fake_node import FakeNode
from fakes.recorder_thread import Device
from fakes.script import Script
from hubodo.cli import main
from hubodo.errors import InputError, WireMismatch
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.ingest.replay import link_redecoder
from hubodo.ingest.replay.redecode import redecode_log
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import open_log, read_recording
from hubowire import Frame, encode, encode_frame
from hubowire.messages import ImuBatch


def messages(path, *kinds):
    """Return (times and bytes) of each node's channels of these kinds."""
    by_channel = {}
    with open_log(path) as log:
        for message in log.messages():
            if message.topic.endswith(kinds) and not message.topic.startswith("/hubodo"):
                row = (message.log_time, message.publish_time, message.data)
                by_channel.setdefault(message.topic, []).append(row)
    return by_channel


def events_of_kinds(path, *kinds):
    """Return the events of these kinds without their time of resolution."""
    events = [event for event in read_recording(path).events if event.kind in kinds]
    return [(event.t_ns, event.kind, event.source, event.text, event.data) for event in events]


def test_decoding_a_recording_of_two_nodes_again_gives_the_same_bits(tmp_path):
    out, again, computer = tmp_path / "ride.mcap", tmp_path / "again.mcap", VirtualComputer()
    with (
        FakeNode(node_id=1, skew_ppm=60, bias_q12=(1, 2, 3), computer=computer) as left,
        FakeNode(node_id=2, batch=1, rate_hz=100, computer=computer) as right,
    ):
        ports = (f"port_side={left.path}", right.path)
        config = RecordConfig(ports=ports, duration=3.0)
        result = record(config, out, computer=computer)
    redecoded = redecode_log(out, again)
    kinds = ("/imu", "/temperature", "/battery", "/bias_filter")
    before, after = messages(out, *kinds), messages(again, *kinds)
    events_of_kinds = {f"/{node}{kind}" for node in ("port_side", "right") for kind in kinds[:3]}
    assert set(before) == events_of_kinds | {"/port_side/bias_filter"}
    for topic, rows in before.items():
        assert [row[1:] for row in rows] == [row[1:] for row in after[topic]], topic
        # Records held for a node's clock were written after those of another node.
        late = np.array([a[0] - b[0] for a, b in zip(rows, after[topic], strict=True)])
        assert np.median(late) == 0 and late.min() >= 0 and late.max() < 5e8
    raw = ("/raw/port_side", "/raw/port_side/damaged")
    with open_log(out) as one, open_log(again) as other:
        raw_frames = [[m.data for m in log.messages() if m.topic.endswith(raw)] for log in (one, other)]
    assert raw_frames[0] == raw_frames[1]
    for name, node in redecoded.nodes.items():
        for key in ("samples", "samples_lost", "frames", "frames_lost", "clock"):
            assert node[key] == result.nodes[name][key], (name, key)
    recording = read_recording(again)
    assert recording.warnings == ()
    assert recording.metadata["decoded_from"] == "ride.mcap"
    assert recording.metadata["node.right.serial"] == b"FAKE0001".hex()


def test_unplugs_damage_and_a_restart_give_the_events_of_the_live_run(tmp_path):
    out, again, computer = tmp_path / "ride.mcap", tmp_path / "again.mcap", VirtualComputer()
    pulled = (1.0, 1.46, 1.92, 3.88)
    trouble = [step for t in pulled for step in ((t, lambda: node.unplug()), (t + 0.06, lambda: node.plug()))]
    Script(computer, *sorted([*trouble, (2.38, lambda: node.reset())], key=itemgetter(0)))
    with FakeNode(node_id=1, rate_hz=416, batch=4, damage=0.002, seed=5, computer=computer) as node:
        config = RecordConfig(ports=("left=FAKE0001",), duration=4.6)
        record(config, out, lister=lambda: [Device(node.path, "FAKE0001")], computer=computer)
    redecode_log(out, again)
    before, after = messages(out, "/imu", "/temperature"), messages(again, "/imu", "/temperature")
    assert before == after
    gaps = events_of_kinds(out, "gap", "reset", "started")
    assert len(gaps) > 8
    assert sorted(gaps, key=str) == sorted(events_of_kinds(again, "gap", "reset", "started"), key=str)
    assert events_of_kinds(out, "connected", "disconnected", "damage") == events_of_kinds(
        again, "connected", "disconnected", "damage"
    )


def test_portions_of_any_size_give_the_same(tmp_path, monkeypatch):
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    with FakeNode(batch=1, bias_q12=(1, 2, 3), computer=computer) as node:
        record(RecordConfig(ports=(node.path,), duration=2.0), out, computer=computer)
    by_channel = []
    for pieces in (7, 100, 100_000):
        monkeypatch.setattr(link_redecoder, "_MAX_PENDING_PIECES", pieces)
        redecode_log(out, tmp_path / f"{pieces}.mcap")
        by_channel.append(messages(tmp_path / f"{pieces}.mcap", "/imu", "/temperature", "/bias_filter"))
    assert (
        by_channel[0]
        == by_channel[1]
        == by_channel[2]
        == messages(out, "/imu", "/temperature", "/bias_filter")
    )


def test_frames_of_another_protocol_are_decoded_by_a_host_of_that_version(tmp_path, monkeypatch):
    out, again, computer = tmp_path / "ride.mcap", tmp_path / "again.mcap", VirtualComputer()
    with FakeNode(fingerprint=0xDEADBEEF, computer=computer) as node, pytest.raises(WireMismatch):
        computer.next_report(0.1)  # its first Hello is lost: batches arrive before the next
        record(RecordConfig(ports=(node.path,), duration=2), out, computer=computer)
    with pytest.raises(WireMismatch, match="deadbeef"):
        redecode_log(out, again)
    assert not again.exists()
    monkeypatch.setattr("hubodo.ingest.node.decoder.FINGERPRINT", 0xDEADBEEF)
    redecode_log(out, again)
    left = read_recording(again).nodes["left"]
    assert len(left) > 0
    np.testing.assert_allclose(np.diff(left.t), 1 / 208, atol=1e-3)


def test_the_verb_decodes_again_and_refuses_logs_without_frames(tmp_path, capsys):
    out, again, computer = tmp_path / "ride.mcap", tmp_path / "again.mcap", VirtualComputer()
    with FakeNode(computer=computer) as node:
        result = record(RecordConfig(ports=(node.path,), duration=1.5), out, computer=computer)
    assert main(["import", str(out), "-o", str(again), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["nodes"]["left"]["samples"] == result.nodes["left"]["samples"] > 100
    assert main(["import", str(out), "-o", str(again)]) == 2
    assert main(["import", str(out), "-o", str(tmp_path / "b.mcap"), "--repair"]) == 2
    bare = tmp_path / "bare.mcap"
    with LogWriter(bare) as log:
        log.write_imu("left", [1, 2], [1, 2], np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(InputError, match="holds no raw frames"):
        redecode_log(bare, tmp_path / "c.mcap")
    assert main(["import", str(bare), "-o", str(tmp_path / "c.mcap")]) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again.mcap", "bare.mcap", "ride.mcap"]


@pytest.mark.parametrize("first", (0, 1))
def test_boards_of_one_id_are_identified_by_the_hello_that_follows_their_first_frames(tmp_path, first):
    bare, again, topic = tmp_path / "bare.mcap", tmp_path / "again.mcap", ("0_0_0_0_47110", "0_0_0_0_47110/2")
    boards = [FakeNode(serial=b"BOARD%03d" % n, rate_hz=100 + 100 * n) for n in (0, 1)]
    with LogWriter(bare, metadata={"ports": "udp://0.0.0.0:47110"}) as log:
        for n, name in enumerate(("left", "left_2")):
            log.add_metadata(f"node.{name}", {"serial": boards[n].serial.hex()})
        for t_ms in range(0, 2000, 40):
            for n in (first, 1 - first):
                hello = boards[n].hello() if t_ms == 400 else None
                for message in filter(None, (hello, batch(boards[n], t_ms))):
                    data = encode_frame(Frame(message.type_id, 1, t_ms // 40, encode(message)))
                    log.write_raw_frame(topic[n], int(1e18) + t_ms * 1_000_000 + n, data)
    redecode_log(bare, again)
    recording = read_recording(again)
    assert [np.diff(recording.nodes[name].t).mean() for name in ("left", "left_2")] == pytest.approx(
        [1 / 100, 1 / 200], rel=1e-3
    )
    assert set(recording.nodes) == {"left", "left_2"}, "frames before the Hello are of the same node"


def batch(node, t_ms):
    """Return the samples of 40 ms that follow a time."""
    count = round(node.rate_hz * 0.04)
    period_ns = round(1e9 / node.rate_hz)
    rows = tuple((0, 0, 100, 0, 0, 1000) for _ in range(count))
    return ImuBatch(t_ms * 1000, period_ns, t_ms // 40 * count, 0, 0, rows)
