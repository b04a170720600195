"""`hubodo record` against fake nodes: received data is in the log, missing data is explained."""

import contextlib
import gc
import io
import itertools
import json
import os
import pty
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import ExitStack
from functools import partial
from gc import get_freeze_count
from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest
import serial
from rich.console import Console

from fakes.fake_node import FakeNode, sample
from fakes.fake_receiver import checked
from fakes.recorder_thread import Device, RecorderThread
from fakes.script import Script
from fakes.talker import Talker
from hubodo.errors import InputError, WireMismatch
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.log.hubodo_messages import decode_bytes_message
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.log.recording_writer import write_recording
from hubodo.log.summary import summarise
from hubodo.recording import BIAS_FILTER_COLUMNS
from hubodo.report.log_page import log_page
from hubodo.vehicle import NodeMount, Vehicle
from hubodo.verbs.info import LogInfo
from hubowire import FINGERPRINT, Frame, decode, encode, encode_frame
from hubowire.framing import FrameDecoder
from hubowire.messages import Hello, TimeRequest
from in_process import hubodo
from repetitions import first_and_more
from waiting import until

ROOT = Path(__file__).resolve().parents[3]
DPS_LSB = np.radians(0.07)
TROLLEY = Vehicle(0.3, 0.9, {"left": NodeMount("left", "left"), "right": NodeMount("right", "left")})


def start_hubodo(*args):
    """Start `hubodo` in its own process."""
    env = {**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"}
    command = [sys.executable, "-m", "hubodo.cli", *map(str, args)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)


def raw_frames(path, link="*"):
    """Yield the raw frames of a log in the order received."""
    for message in open_log(path).messages():
        if message.topic.startswith("/hubodo/raw/") and not message.topic.endswith("/damaged"):
            yield decode_bytes_message("cdr", message.data)


def events(path, kind):
    return [event for event in read_recording(path).events if event.kind == kind]


def test_two_nodes_are_recorded_with_every_sample_and_times_of_the_host_clock(tmp_path):
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    before = computer.now_ns() * 1e-9
    with (
        FakeNode(node_id=1, skew_ppm=60, computer=computer) as left,
        FakeNode(node_id=2, computer=computer) as right,
    ):
        config = RecordConfig(ports=(left.path, right.path), duration=2.5)
        result = record(config, out, vehicle=TROLLEY, computer=computer)
    recording = read_recording(out)
    assert recording.warnings == ()
    for name in ("left", "right"):
        table = recording.nodes[name]
        assert len(table) == result.nodes[name]["samples"] > 350
        assert result.nodes[name]["samples_lost"] == 0
        first = round(table["gx"][0] / DPS_LSB) + 0x4000
        expected = np.array([sample(first + k) for k in range(len(table))])
        np.testing.assert_allclose(table.gyro, expected[:, :3] * DPS_LSB, rtol=1e-12)
        np.testing.assert_allclose(table.accel, expected[:, 3:] * 0.488e-3 * 9.80665, rtol=1e-12)
        wall = table.t + recording.t_zero_ns * 1e-9
        assert wall[0] == pytest.approx(before, abs=1e-3)
        assert wall[-1] == pytest.approx(before + len(table) / 208, abs=0.006)
        # Until the drift of 60 ppm is estimated, the clock is corrected once per second.
        np.testing.assert_allclose(np.diff(table.t), 1 / 208, atol=70e-6)
        assert result.nodes[name]["clock"]["source"] == "two way"
        assert result.nodes[name]["rate_hz"] == pytest.approx(208, rel=1e-4)
    assert len(recording.odometry) == result.odometry["poses"] > 100
    assert recording.metadata["node.left.fingerprint"] == f"{FINGERPRINT:08x}"
    json.dumps(result.as_json(), allow_nan=False)


@pytest.mark.parametrize("is_frozen", [True, False])
def test_objects_frozen_for_the_garbage_collector_stay_frozen_after_a_recording(
    tmp_path, monkeypatch, is_frozen
):
    monkeypatch.setattr(gc, "get_freeze_count", get_freeze_count)  # instead of the one of conftest.py
    computer = VirtualComputer()
    gc.unfreeze()
    if is_frozen:
        gc.freeze()
    try:
        with FakeNode(computer=computer) as node:
            config = RecordConfig(ports=(node.path,), duration=0.5)
            record(config, tmp_path / "ride.mcap", computer=computer)
        assert bool(gc.get_freeze_count()) == is_frozen
    finally:
        gc.freeze()


def test_ten_disconnections_damage_and_a_reset_lose_no_frame_and_every_gap_has_a_cause(tmp_path):
    """The device has another name after each disconnection; the recorder finds it by serial number."""
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    seed = 7

    def devices():
        return [Device(node.path, "FAKE0001")] if node.path else []

    times = [1.0 + 0.4 * turn + (1.5 if turn > 5 else 0.0) for turn in range(10)]
    faults = [step for t in times for step in ((t, lambda: node.unplug()), (t + 0.06, lambda: node.plug()))]
    Script(computer, *sorted([*faults, (times[5] + 0.36, lambda: node.reset())], key=itemgetter(0)))
    with FakeNode(node_id=1, rate_hz=416, batch=4, damage=0.01, seed=seed, computer=computer) as node:
        config = RecordConfig(ports=("left=FAKE0001",), duration=7.5)
        record(config, out, lister=devices, computer=computer)
    logged = set(raw_frames(out))
    assert logged <= {sent.wire for sent in node.frames if sent.intact}, (
        "the log contains a frame that was never sent"
    )
    for plug in range(1, node.plugs + 1):
        is_logged = [sent.wire in logged for sent in node.frames if sent.whole and sent.plug == plug]
        # Frames sent before the recorder has opened the device are not recorded.
        assert all(is_logged[is_logged.index(True) :]), f"seed {seed}, plug {plug}"
        assert is_logged.index(True) < 20
    recording = read_recording(out)
    assert recording.warnings == ()
    resets, gaps = events(out, "reset"), events(out, "gap")
    assert len(resets) == 1
    assert len(events(out, "disconnected")) == 10
    connected = [event.data["where"] for event in events(out, "connected")]
    assert len(connected) == 11
    assert all(a != b for a, b in itertools.pairwise(connected))
    causes = Counter(gap.data["cause"] for gap in gaps if gap.data["stream"] == "ImuBatch")
    assert causes["link down"] >= 9
    assert causes["node restarted"] == 1
    assert causes["damaged bytes"] > 20
    assert set(causes) <= {"link down", "node restarted", "damaged bytes"}, f"seed {seed}"
    # For each start of the node: received + lost samples = span of their numbers.
    numbers = np.round(recording.nodes["left"]["gx"] / DPS_LSB).astype(int) + 0x4000
    lost = sum(gap.data["samples_lost"] or 0 for gap in gaps if gap.data["stream"] == "ImuBatch")
    first_new = int(np.argmax(numbers >= node.boot_indices[1]))
    spans = (numbers[first_new - 1] - numbers[0] + 1) + (numbers[-1] - numbers[first_new] + 1)
    assert len(numbers) + lost == spans, f"seed {seed}"


def test_frames_dropped_by_the_node_are_named_as_the_cause(tmp_path):
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    Script(computer, (1.2, lambda: node.lose(3)))
    with FakeNode(computer=computer) as node:
        record(RecordConfig(ports=(node.path,), duration=2.8), out, computer=computer)
    (gap,) = events(out, "gap")
    assert gap.data["cause"] == "node dropped frames"
    assert gap.data["samples_lost"] == 24


def test_a_node_that_answers_nothing_is_recorded_with_the_uncertainty_of_one_way_times(tmp_path):
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    with FakeNode(answers=False, hello_period=0.5, computer=computer) as node:
        result = record(RecordConfig(ports=(node.path,), duration=1.5), out, computer=computer)
    assert result.nodes["left"]["samples"] > 250
    clock = result.nodes["left"]["clock"]
    assert clock["source"] == "one way"
    assert clock["sigma"] > 0.005


def test_the_bias_reports_of_a_node_are_in_log_summary_and_page_and_in_a_rewritten_log(tmp_path):
    out, again, computer = tmp_path / "ride.mcap", tmp_path / "again.mcap", VirtualComputer()
    with FakeNode(bias_q12=(4096, -2048, 410), computer=computer) as node:
        result = record(RecordConfig(ports=(node.path,), duration=2.0), out, computer=computer)
    reported_bias = np.array([4096, -2048, 410]) / 4096 * DPS_LSB
    np.testing.assert_allclose(result.nodes["left"]["bias_filter"]["bias"], reported_bias, rtol=1e-12)
    assert result.nodes["left"]["bias_filter"]["sigma"][1] is None
    json.dumps(result.as_json(), allow_nan=False)
    recording = read_recording(out)
    table = recording.bias_filters["left"]
    assert tuple(table) == BIAS_FILTER_COLUMNS
    assert len(table) == 10
    for axis, value in zip("xyz", reported_bias, strict=True):
        np.testing.assert_allclose(table[f"bias_{axis}"], value, rtol=1e-12)
    np.testing.assert_allclose(table["sigma_x"], 41 / 4096 * DPS_LSB, rtol=1e-12)
    assert np.isnan(table["sigma_y"]).all()
    samples = recording.nodes["left"]
    assert samples.t[0] - 0.05 < table.t[0] < table.t[-1] < samples.t[-1] + 0.05
    assert recording.warnings == ()
    summary = summarise(out)
    assert summary.bias_filters["left"]["bias_x"] == pytest.approx(reported_bias[0], rel=1e-12)
    shown = io.StringIO()
    LogInfo(summary).render(Console(file=shown, width=200))
    assert "bias filter of left" in shown.getvalue()
    assert "x +0.070 ± 0.001, y -0.035, z +0.007 ± 0.001 °/s, from 2000 samples" in shown.getvalue()
    json.dumps(LogInfo(summary).as_json(), allow_nan=False)
    page = log_page("ride", recording, summary)
    assert any(
        line.startswith("left: bias of the node's own filter at the end: x +0.070") for line in page.facts
    )
    assert "left: bias of the node" in page.html
    write_recording(recording, again)
    for column in table:
        np.testing.assert_array_equal(read_recording(again).bias_filters["left"][column], table[column])


def test_start_order_does_not_matter_with_wait(tmp_path):
    out, link, computer = tmp_path / "ride.mcap", tmp_path / "ttyNODE", VirtualComputer()
    with ExitStack() as stack:
        Script(computer, (0.5, lambda: stack.enter_context(FakeNode(link=link, computer=computer))))
        config = RecordConfig(ports=(str(link),), wait=True, duration=2.0)
        result = record(config, out, computer=computer)
    assert result.nodes["left"]["samples"] > 250
    assert "no such device" in events(out, "disconnected")[0].text


def test_a_node_with_another_protocol_is_refused_by_name_and_its_raw_frames_stored(tmp_path):
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    with (
        FakeNode(fingerprint=0xDEADBEEF, computer=computer) as node,
        pytest.raises(WireMismatch, match=r"speaks deadbeef .*host speaks .*flash"),
    ):
        record(RecordConfig(ports=(node.path,), duration=5), out, computer=computer)
    assert len(list(raw_frames(out))) > 0
    assert len(events(out, "mismatch")) == 1
    assert read_recording(out).nodes == {}


def test_a_node_with_another_protocol_does_not_end_the_recording_of_a_valid_one(tmp_path):
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    with (
        FakeNode(node_id=1, fingerprint=1, computer=computer) as old,
        FakeNode(node_id=2, computer=computer) as valid,
    ):
        shown = io.StringIO()
        config = RecordConfig(ports=(old.path, valid.path), duration=1.5)
        result = record(config, out, computer=computer, console=Console(file=shown, width=500))
    assert "flash" in result.nodes["left"]["refused"]
    assert result.nodes["right"]["samples"] > 250
    assert shown.getvalue().count("node 'left' speaks 00000001 (firmware 0.1.0), host speaks") == 1


def test_nodes_that_run_different_firmware_are_named_while_recording_and_in_the_log(tmp_path):
    out, computer, shown = tmp_path / "ride.mcap", VirtualComputer(), io.StringIO()
    with (
        FakeNode(node_id=1, computer=computer) as old,
        FakeNode(node_id=2, firmware=(0, 2, 0), computer=computer) as new,
    ):
        config = RecordConfig(ports=(old.path, new.path), duration=7.0)
        record(config, out, computer=computer, console=Console(file=shown, width=500))
    line = "nodes run different firmware: left 0.1.0, right 0.2.0"
    assert shown.getvalue().count(line) == 1
    assert [event.kind for event in read_recording(out).events if line in event.text] == ["warning"]


@pytest.mark.parametrize(("port", "names"), [("right={}", ["left", "right"]), ("{}", ["left", "left_2"])])
def test_two_nodes_with_one_name_are_both_recorded(tmp_path, port, names):
    computer = VirtualComputer()
    with FakeNode(node_id=1, computer=computer) as one, FakeNode(node_id=1, computer=computer) as two:
        config = RecordConfig(ports=(one.path, port.format(two.path)), duration=1.2)
        result = record(config, tmp_path / "ride.mcap", computer=computer)
    assert sorted(result.nodes) == names


def test_nodes_are_recorded_over_tcp_and_udp(tmp_path):
    """One node is bridged to TCP, the other one to UDP datagrams."""
    out, bytes_to_node = tmp_path / "ride.mcap", Counter()
    server = socket.create_server(("127.0.0.1", 0))
    tcp_port = server.getsockname()[1]
    probe = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    probe.bind(("127.0.0.1", 0))
    udp_port = probe.getsockname()[1]
    probe.close()
    done = threading.Event()

    def bridge(node, send, receive):
        fd = os.open(node.path, os.O_RDWR | os.O_NONBLOCK)
        decoder = FrameDecoder()
        while not done.wait(0.005):
            try:
                data = os.read(fd, 4096)
            except BlockingIOError:
                data = b""
            for stuffed in decoder.split_frames(data):
                send(stuffed + b"\0")
            # The recorder may end first and reset the connection.
            with contextlib.suppress(BlockingIOError, ConnectionError):
                data_to_node = receive()
                bytes_to_node[node.node_id] += len(data_to_node)
                os.write(fd, data_to_node)
        os.close(fd)

    def serve_tcp(node):
        peer, _ = server.accept()
        peer.setblocking(False)
        bridge(node, peer.sendall, lambda: peer.recv(4096))
        peer.close()

    def serve_udp(node):
        peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        peer.setblocking(False)
        bridge(node, lambda data: peer.sendto(data, ("127.0.0.1", udp_port)), lambda: peer.recv(4096))
        peer.close()

    with FakeNode(node_id=1) as left, FakeNode(node_id=2) as right:
        threads = [
            threading.Thread(target=serve_tcp, args=(left,)),
            threading.Thread(target=serve_udp, args=(right,)),
        ]
        for thread in threads:
            thread.start()
        ports = (f"socket://127.0.0.1:{tcp_port}", f"udp://127.0.0.1:{udp_port}")
        with RecorderThread(out, *ports) as recorder:
            until(lambda: min(bytes_to_node[1], bytes_to_node[2]) > 100)
            samples = left.samples_created
            until(lambda: left.samples_created > samples + 100)
        result = recorder.result
        done.set()
        for thread in threads:
            thread.join(5)
    server.close()
    for name in ("left", "right"):
        assert result.nodes[name]["samples"] > 100
        assert result.nodes[name]["samples_lost"] == 0
        assert result.nodes[name]["clock"]["source"] == "two way"


@pytest.mark.parametrize("number", first_and_more(signal.SIGTERM, signal.SIGINT))
def test_a_signal_leaves_a_complete_file_and_exit_code_0(tmp_path, number):
    out = tmp_path / "ride.mcap"
    with FakeNode() as node, start_hubodo("record", node.path, "-o", out, "--json") as process:
        until(lambda: out.exists() and out.stat().st_size > 3000)
        process.send_signal(number)
        stdout, stderr = process.communicate()
    assert process.returncode == 0, stderr
    assert json.loads(stdout)["nodes"]["left"]["samples"] == len(read_recording(out).nodes["left"])
    assert read_recording(out).warnings == ()


def refusal(tmp_path, *args, computer=None):
    """Return the last line of stderr of a refused recording (exit code 2, no output, no file)."""
    out = tmp_path / "ride.mcap"
    done = hubodo("record", *args, "-o", out, computer=computer)
    assert done.code == 2, done.err
    assert done.out == ""
    assert not out.exists()
    return done.err.strip().splitlines()[-1]


def test_a_port_that_does_not_exist_is_refused(tmp_path):
    line = refusal(tmp_path, "/dev/ttyNOPE7")
    assert "/dev/ttyNOPE7: no such device" in line
    assert "--wait" in line


def test_an_unknown_serial_number_is_refused(tmp_path):
    assert "no device with serial number 'E66058388347'" in refusal(tmp_path, "E66058388347")


def test_a_busy_port_is_refused(tmp_path):
    master, slave = pty.openpty()
    holder = serial.Serial(os.ttyname(slave), exclusive=True)
    assert "busy: another program has opened it" in refusal(tmp_path, os.ttyname(slave))
    holder.close()
    os.close(master)
    os.close(slave)


def test_a_file_that_is_no_port_is_refused(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("hello")
    assert "not a serial port" in refusal(tmp_path, path)


@pytest.mark.parametrize("port", ["http://host:1", "socket://host", "udp://:x", "", "what is this"])
def test_an_invalid_port_is_refused(tmp_path, port):
    assert "port" in refusal(tmp_path, port)


def test_an_existing_log_is_not_overwritten(tmp_path):
    out = tmp_path / "ride.mcap"
    out.write_bytes(b"precious")
    with FakeNode() as node, pytest.raises(InputError, match="exists already"):
        record(RecordConfig(ports=(node.path,), duration=1), out)
    assert out.read_bytes() == b"precious"


def test_a_micropython_prompt_is_named_and_refused(tmp_path):
    computer = VirtualComputer()
    prompt = b"MicroPython v1.27.0 on 2026-01-01; Raspberry Pi Pico\r\n>>> "
    with Talker(computer, 0.1, lambda since: prompt) as stranger:
        line = refusal(tmp_path, stranger.path, computer=computer)
    assert "MicroPython prompt" in line
    assert "hubodo flash" in line


def test_nothing_is_sent_before_the_first_frame_of_a_node_and_never_a_ctrl_c(tmp_path):
    """Ctrl-C would stop a booting MicroPython board, and an unknown device might act on any byte."""
    computer = VirtualComputer()
    node = FakeNode(computer=computer)
    hello = encode_frame(Frame(Hello.type_id, 3, 0, encode(node.hello())))
    node.stop()
    with Talker(computer, 0.1, lambda since: hello if since > 1.0 else b"") as port:
        record(RecordConfig(ports=(port.path,), duration=3.0), tmp_path / "ride.mcap", computer=computer)
    assert port.received[0][0] > 1.0
    received = b"".join(data for _, data in port.received)
    requests = {type(decode(frame.type_id, frame.payload)) for frame in FrameDecoder().feed(received)}
    assert TimeRequest in requests
    assert b"\x03" not in received


def test_after_a_kill_all_but_the_last_second_is_recovered(tmp_path):
    """A copy of the file during recording stands for the file after a kill at that time."""
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    start = computer.now_ns() * 1e-9
    kill_times = (1.7, 2.43, 3.9)
    Script(computer, *((t, partial(shutil.copy, out, tmp_path / f"{t}.mcap")) for t in kill_times))
    with FakeNode(computer=computer) as node:
        record(RecordConfig(ports=(node.path,), duration=4.0), out, computer=computer)
    for t in kill_times:
        killed, repaired = tmp_path / f"{t}.mcap", tmp_path / f"{t}-repaired.mcap"
        done = hubodo("recover", killed, "-o", repaired)
        assert done.code == 0, done.err
        recovered = read_recording(repaired)
        newest = recovered.t_zero_ns * 1e-9 + recovered.nodes["left"].t[-1]
        assert start + t - 1.0 < newest < start + t


def test_a_gnss_receiver_is_recorded_beside_the_nodes(tmp_path):
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    start = computer.now_ns() * 1e-9

    def nmea_sentences(since):
        now = time.gmtime(start + since)
        time_of_day, day = time.strftime("%H%M%S.00", now), time.strftime("%d%m%y", now)
        bodies = (
            f"GNGGA,{time_of_day},4807.0380000,N,01131.0000000,E,4,12,0.7,545.4,M,46.9,M,1.0,0000",
            f"GNRMC,{time_of_day},A,4807.0380000,N,01131.0000000,E,0.10,,{day},,,R",
            f"GNGST,{time_of_day},0.02,0.03,0.02,45.0,0.012,0.018,0.035",
        )
        return b"".join(checked(body) for body in bodies)

    with FakeNode(computer=computer) as node, Talker(computer, 1.0, nmea_sentences) as receiver:
        config = RecordConfig(ports=(node.path,), gnss=receiver.path, duration=3.5)
        result = record(config, out, computer=computer)
    assert result.gnss["gnss"]["checksum_errors"] == 0
    assert result.nodes["left"]["samples"] > 200
    gnss = read_recording(out).gnss
    assert len(gnss) == 3
    assert gnss["latitude_deg"][0] == pytest.approx(48 + 7.038 / 60)
    assert gnss["altitude"][0] == pytest.approx(592.3)
    with open_log(out) as log:
        assert sum(m.topic == "/gnss/nmea" for m in log.messages()) > 0


def test_the_result_shows_every_node_and_link(tmp_path):
    computer = VirtualComputer()
    with FakeNode(node_id=1, computer=computer) as left, FakeNode(node_id=2, computer=computer) as right:
        config = RecordConfig(ports=(left.path, right.path), duration=1.2)
        result = record(config, tmp_path / "a.mcap", vehicle=TROLLEY, computer=computer)
    console = Console(record=True, width=160, file=io.StringIO())
    result.render(console)
    shown = console.export_text()
    for part in ("left", "right", "link", "odometry", "two way", "gaps"):
        assert part in shown
