"""Two nodes with one id and with keys on one UDP port, beside an attacker: each is recorded completely."""

import socket
import threading

import numpy as np
import pytest

from fakes.recorder_thread import RecorderThread
from hubodo.cli import main
from hubodo.emulator.board.settings import BoardSettings, Clock, Flash, Host
from hubodo.emulator.virtual_node import VirtualNode
from hubodo.ingest.link.keys import KeyRing
from hubodo.log.recording_reader import open_log, read_recording
from virtual_runs import FIRMWARE, unique_motion
from waiting import until

pytestmark = pytest.mark.real_time

SERIALS = ("e661410300000001", "e661410300000002")
SECONDS = 5


class Eavesdropper:
    """An attacker between nodes and host who forwards, replays and forges datagrams."""

    def __init__(self, to):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self._to, self._ways, self._stored, self.ended = to, {}, [], False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        while not self.ended:
            data, node = self.socket.recvfrom(2048)
            if node not in self._ways:
                self._ways[node] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                threading.Thread(target=self._back, args=(node,), daemon=True).start()
            route = self._ways[node]
            route.sendto(data, self._to)
            if data[:1] == b"\xff":
                self._stored.append(data)
                if len(self._stored) % 20 == 0:
                    route.sendto(self._stored[0], self._to)
                    route.sendto(data[9:-8], self._to)

    def _back(self, node):
        while not self.ended:
            self.socket.sendto(self._ways[node].recv(2048), node)


def test_nodes_of_one_id_are_recorded_separately_and_replayed_or_unkeyed_data_is_refused(tmp_path):
    ring = KeyRing(tmp_path / "keys.toml", create=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        number = free.getsockname()[1]
    between = Eavesdropper(("127.0.0.1", number))
    log = tmp_path / "udp.mcap"
    config = {"link": "udp", "rate_hz": 208, "ssid": "net", "host": "127.0.0.1", "port": between.port}
    nodes = [
        VirtualNode(
            unique_motion(30),
            Flash(FIRMWARE, config | {"key": ring.get_or_create_key(serial).hex()}),
            board=BoardSettings(unique_id=serial, interpreter="cpython"),
            clock=Clock("paced", ticks_start_us=serial_number * 1_000_000),
            host=Host("udp"),
            own_process=False,
        )
        for serial_number, serial in enumerate(SERIALS)
    ]
    with RecorderThread(log, f"udp://127.0.0.1:{number}", key_file=str(tmp_path / "keys.toml")) as recorder:
        until(log.exists)
        with nodes[0], nodes[1]:
            until(lambda: min(node.stats["t"] for node in nodes) > SECONDS)
            recorder.stop.set()
            recorder.thread.join(300)
            truths = [node.chip.truth() for node in nodes]
    between.ended = True
    judge(log, truths)
    again = tmp_path / "again.mcap"
    assert main(["import", str(log), "-o", str(again)]) == 0
    judge(again, truths, first=read_recording(log))


def judge(log, truths, first=None):
    """Check that both boards are in the log by serial, each with its own chip's samples without a gap."""
    recording = read_recording(log)
    assert set(recording.nodes) == {"left", "left_2"}
    with open_log(log) as records:
        serials = {name: records.metadata_records[f"node.{name}"]["serial"] for name in recording.nodes}
        events = [r.data for r in records.messages() if r.topic == "/hubodo/events"]
    assert sorted(serials.values()) == sorted(SERIALS)
    assert not [event for event in events if b"gap" in event]
    for name, table in recording.nodes.items():
        gyro = np.column_stack([table.columns[axis] for axis in ("gx", "gy", "gz")])
        truth = truths[SERIALS.index(serials[name])]
        expected = truth.raw[:, :3] * truth.lsb[:, :3]
        start = int(np.argmin(np.abs(expected - gyro[0]).sum(axis=1)))
        assert len(gyro) > (SECONDS - 2) * 208
        assert np.allclose(gyro, expected[start : start + len(gyro)]), "its own chip's samples, one by one"
        assert first is None or len(gyro) == len(first.nodes[name].t)
    for why in (b"sent again", b"without a key"):
        assert any(why in event for event in events)
