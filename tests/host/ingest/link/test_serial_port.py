"""Both ways of reading a serial device, direct and by pyserial, behave the same."""

import os
import pty
import random
import socket
import threading
import time
import tty
from functools import partial

import numpy as np
import pytest
import serial

from fakes.fake_node import FakeNode
from fakes.recorder_thread import Device
from fakes.script import Script
from hubodo.errors import LinkError
from hubodo.ingest.link import serial_port, transport
from hubodo.ingest.link.open_link import LinkDown
from hubodo.ingest.link.ports import DeviceFinder, parse_port
from hubodo.ingest.link.serial_port import open_serial
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.log.recording_reader import read_recording

BAUD = 115_200
STEP = np.radians(0.07)
"""Of the fake node's gyro, rad/s."""


@pytest.fixture(params=["native", "portable"])
def opens(request):
    return partial(open_serial, baud=BAUD, portable=request.param == "portable")


class Terminal:
    """A pseudo terminal: `near` is the node's end, `path` the port."""

    def __enter__(self):
        self.near, self.far = pty.openpty()
        tty.setraw(self.far)
        self.path = os.ttyname(self.far)
        return self

    def unplug(self):
        for fd in (self.near, self.far):
            if fd >= 0:
                os.close(fd)
        self.near = self.far = -1

    def __exit__(self, *_):
        self.unplug()


def test_bytes_arrive_complete_in_order_and_in_blocks(opens):
    sent = random.Random(3).randbytes(60_000)
    with Terminal() as terminal:
        link = opens(terminal.path)
        thread = threading.Thread(
            target=lambda: [os.write(terminal.near, sent[i : i + 500]) for i in range(0, 60_000, 500)]
        )
        thread.start()
        received, reads = b"", 0
        while len(received) < len(sent):
            data, sender = link.read(10.0)
            assert sender == "" and data, "silence"
            received, reads = received + data, reads + 1
        thread.join()
        link.close()
    assert received == sent
    assert reads < 20_000, "not a byte at a time"


def test_silence_is_no_bytes_and_no_error(opens):
    with Terminal() as terminal:
        link = opens(terminal.path)
        start = time.monotonic()
        assert [link.read(0.0), link.read(0.05), link.read(0.0)] == [(b"", "")] * 3
        assert time.monotonic() - start >= 0.05
        link.close()


def test_written_bytes_arrive_and_a_full_line_does_not_block_forever(opens):
    with Terminal() as terminal:
        link = opens(terminal.path)
        link.write(b"\0hello\x03\x11\x13\xff", "")
        assert os.read(terminal.near, 100) == b"\0hello\x03\x11\x13\xff"
        for _ in range(5):
            link.write(bytes(30_000), "")  # the other side does not read
        link.close()


def test_unplugging_is_one_error_for_readers_and_for_writers(opens):
    with Terminal() as terminal:
        link = opens(terminal.path)
        os.write(terminal.near, b"last words")
        assert link.read(1.0)[0] == b"last words"
        terminal.unplug()
        with pytest.raises(LinkDown, match=terminal.path):
            for _ in range(3):
                link.read(0.1)
        with pytest.raises(LinkDown, match=terminal.path):
            link.write(b"?", "")
        link.close()
        link.close()


def test_a_port_closed_under_its_reader_is_the_same_error(opens):
    with Terminal() as terminal:
        link = opens(terminal.path)
        link.close()
        with pytest.raises(LinkDown):
            link.read(0.1)


def test_a_port_that_cannot_be_opened_is_reported_with_a_remedy(opens, tmp_path):
    with Terminal() as terminal:
        holder = serial.Serial(terminal.path, exclusive=True)
        with pytest.raises(LinkError, match="busy: another program has opened it; close that program"):
            opens(terminal.path)
        holder.close()
    with pytest.raises(LinkError, match="no such device; plug it in"):
        opens(str(tmp_path / "ttyACM7"))
    (tmp_path / "notes").write_text("hello")
    with pytest.raises(LinkError, match="not a serial port"):
        opens(str(tmp_path / "notes"))


def test_errors_of_windows_for_a_missing_and_a_busy_port_are_recognised(monkeypatch):
    """Errors as raised by pyserial on Windows, without errno."""
    sent = {
        "COM7": "could not open port 'COM7': FileNotFoundError(2, 'The system cannot find it', None, 2)",
        "COM3": "could not open port 'COM3': PermissionError(13, 'Access is denied.', None, 5)",
    }

    def refuse(url, *_, **__):
        raise serial.SerialException(sent[url])

    monkeypatch.setattr(serial_port.serial, "serial_for_url", refuse)
    with pytest.raises(LinkError, match="COM7: no such device; plug it in"):
        open_serial("COM7", BAUD, portable=True)
    with pytest.raises(LinkError, match="COM3: busy: another program has opened it"):
        open_serial("COM3", BAUD, portable=True)


@pytest.mark.parametrize(
    ("text", "name", "label"),
    [("COM3", None, "COM3"), ("left=com12", "left", "left"), (r"\\.\COM4", None, "COM4")],
)
def test_a_windows_port_is_a_device_that_is_there_when_it_is_listed(text, name, label):
    port = parse_port(text)
    assert (port.kind, port.name, port.label) == ("device", name, label)
    listed = [Device(port.target.removeprefix("\\\\.\\").upper(), "E661")]
    assert DeviceFinder(port, lambda: listed).find_device() == port.target
    with pytest.raises(LinkError, match="no such device"):
        DeviceFinder(port, list).find_device()


def test_a_loop_and_a_socket_are_read_by_pyserials_urls():
    loop = open_serial("loop://", BAUD, portable=True)
    loop.write(b"round and round", "")
    assert loop.read(1.0) == (b"round and round", "")
    assert loop.read(0.0) == (b"", "")
    loop.close()
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = open_serial(f"socket://127.0.0.1:{server.getsockname()[1]}", BAUD, portable=True)
        peer, _ = server.accept()
        peer.sendall(b"over the net")
        received = b""
        while len(received) < 12:
            received += link.read(5.0)[0]
        assert received == b"over the net"
        peer.close()
        with pytest.raises(LinkDown):
            link.read(5.0)
        link.close()


def test_a_recording_by_pyserial_survives_unplugging_like_the_native_one(tmp_path, monkeypatch):
    monkeypatch.setattr(transport, "open_serial", partial(open_serial, portable=True))
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    with FakeNode(node_id=1, computer=computer) as node:
        Script(computer, (1.0, lambda: node.unplug()), (1.1, lambda: node.plug()))
        config = RecordConfig(ports=("left=FAKE0001",), duration=2.5)
        lister = lambda: [Device(node.path, "FAKE0001")] if node.path else []  # noqa: E731
        result = record(config, out, lister=lister, computer=computer)
    recording = read_recording(out)
    assert recording.warnings == () and result.links["left"]["disconnections"] == 1
    raw = (recording.nodes["left"].gyro[:, 0] / STEP).round().astype(int) + 0x4000
    assert (raw[1:] > raw[:-1]).all() and len(raw) > 300
    (gap,) = [
        event for event in recording.events if event.kind == "gap" and event.data["stream"] == "ImuBatch"
    ]
    assert gap.data["cause"] == "link down"
    assert len(raw) + gap.data["samples_lost"] == raw[-1] - raw[0] + 1, "not one sample is unaccounted for"
