"""Long recordings: log rotation, service manager, disk space, timely end."""

import contextlib
import io
import json
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from fakes.fake_node import FakeNode
from fakes.script import Script
from hubodo.ingest.link.link import Chunk, LinkUp
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.loop import Loop
from hubodo.ingest.live.metrics import assess_health
from hubodo.ingest.live.notify import ServiceNotifier
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.log.disk_space import RotationRules
from hubodo.log.hubodo_messages import decode_bytes_message
from hubodo.log.log_series import LogSeries
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.units import NS_PER_S
from hubodo.vehicle import NodeMount, Vehicle
from hubowire import Frame, encode, encode_frame
from hubowire.messages import ImuBatch
from in_process import hubodo
from repetitions import first_and_more
from vehicles import vehicle_toml
from waiting import until

ROOT = Path(__file__).resolve().parents[4]
TROLLEY = Vehicle(0.3, 0.9, {"left": NodeMount("left", "left"), "right": NodeMount("right", "left")})


@pytest.fixture(scope="module")
def pieces(tmp_path_factory):
    """Return (logs of a drive rotated each 5 s, the single log of the same drive)."""
    parts = []
    for name, rules in (("cut", {"rotate_after": 5.0}), ("whole", {})):
        out, computer = tmp_path_factory.mktemp(name) / "drive.mcap", VirtualComputer()
        computer._now_ns = 1_774_000_000 * NS_PER_S
        rows = [(0, 0, 3000 + k % 7, 0, 2048, 0) for k in range(2048)]
        with (
            FakeNode(
                node_id=1, rate_hz=104, bias_q12=(9, 9, 9), rows=rows, seed=1, computer=computer
            ) as left,
            FakeNode(node_id=2, rate_hz=104, rows=rows, seed=2, computer=computer) as right,
        ):
            config = RecordConfig(ports=(left.path, right.path), duration=12.0, **rules)
            result = record(config, out, vehicle=TROLLEY, computer=computer)
        parts.append([Path(path) for path in result.files])
    return parts[0], parts[1][0]


def concatenated(paths, pick):
    """Return a table's columns, concatenated over the logs."""
    tables = [pick(read_recording(path).nodes) for path in paths]
    return {key: np.concatenate([table[key] for table in tables]) for key in tables[0]}


def test_rotated_logs_hold_the_samples_of_a_single_log(pieces):
    cut, whole = pieces
    assert len(cut) == 3
    assert all(path.name.startswith(f"drive-00000{k}-2026") for k, path in enumerate(cut, 1))
    for name in ("left", "right"):
        one, many = (concatenated(paths, itemgetter(name)) for paths in ([whole], cut))
        assert one.keys() == many.keys()
        for column in one:
            if column != "t":
                np.testing.assert_array_equal(many[column], one[column])
        # Each rotation sends an additional clock request, which only improves the times.
        np.testing.assert_allclose(many["t"], one["t"], rtol=0, atol=5e-4)
    t = np.concatenate([read_recording(path).odometry.t for path in cut])
    assert len(t) > 1000
    assert (np.diff(t) > 0).all()
    assert np.diff(t).max() < 0.05, "live odometry went on over each cut"


def test_each_of_them_knows_its_nodes_and_can_be_decoded_again_and_read_by_every_verb(pieces, tmp_path):
    vehicle = tmp_path / "vehicle.toml"
    vehicle.write_text(vehicle_toml())
    for k, path in enumerate(pieces[0]):
        recording = read_recording(path)
        assert recording.warnings == ()
        assert {"node.left.serial", "node.right.serial"} <= recording.metadata.keys()
        assert {e.source for e in recording.events if e.kind == "started"} == {"left", "right"}
        again = tmp_path / f"again{k}.mcap"
        done = hubodo("import", path, "-o", again)
        assert done.code == 0, done.err
        for name in ("left", "right"):
            before, after = recording.nodes[name], read_recording(again).nodes[name]
            # Samples held for clock synchronisation during a rotation have their frames in the previous log.
            assert abs(len(after) - len(before)) <= 16
        assert hubodo("info", path).code == 0
        assert hubodo("export", path, "-o", tmp_path / f"csv{k}").code == 0
        assert hubodo("recover", path, "-o", tmp_path / f"rec{k}.mcap").code == 0
        fused = hubodo("fuse", path, "--vehicle", vehicle, "-o", tmp_path / f"fuse{k}")
        assert fused.code == 0, fused.err
        track = np.genfromtxt(tmp_path / f"fuse{k}" / "track.csv", delimiter=",", names=True)
        assert abs(track["t"][0] - recording.nodes["left"].t[0]) < 2


class Manager:
    """A service manager like systemd: a datagram socket that receives the notifications."""

    def __init__(self, folder):
        self.path = folder / "notify"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(self.path))
        self._socket.setblocking(False)
        self.notifications = []

    def listen(self):
        try:
            while True:
                self.notifications.append(self._socket.recv(4096).decode())
        except BlockingIOError:
            return self.notifications

    def samples(self):
        """Return the first and last reported sample count by name of each log."""
        status_lines = {}
        for word in self.listen():
            if match := re.match(r"STATUS=recording ([^;]+);.* (\d+) samples", word):
                count = int(match[2])
                status_lines[match[1]] = (status_lines.get(match[1], (count,))[0], count)
        return status_lines

    def close(self):
        self._socket.close()


@pytest.mark.real_time
def test_a_service_notifies_systemd_rotates_on_hangup_and_ends_with_a_complete_log(tmp_path):
    manager, logs = Manager(tmp_path), tmp_path / "logs"
    logs.mkdir()
    env = {
        **os.environ,
        "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}",
        "NOTIFY_SOCKET": str(manager.path),
        "WATCHDOG_USEC": "600000",
    }
    with FakeNode() as node:
        words = [sys.executable, "-m", "hubodo.cli", "record", node.path, "-o", logs, "--wait", "--json"]
        with subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env
        ) as run:
            until(lambda: "READY=1" in manager.listen())
            until(lambda: any(last > first for first, last in manager.samples().values()))
            run.send_signal(signal.SIGHUP)
            until(lambda: [last > first for first, last in manager.samples().values()] == [True, True])
            until(lambda: sum("WATCHDOG=1" in word for word in manager.listen()) > 3)
            until(
                lambda: any(
                    ", 0 lost" in word and "nodes, 0 samples" not in word for word in manager.listen()
                )
            )
            run.send_signal(signal.SIGTERM)
            out, err = run.communicate()
    assert run.returncode == 0, err
    notifications = manager.listen()
    manager.close()
    assert notifications[0] == "READY=1"
    assert "STOPPING=1" in notifications
    assert any(word.startswith("STATUS=recording 000001-20") for word in notifications)
    status_lines = json.loads(out)
    assert len(status_lines["files"]) == 2
    numbers = np.concatenate(
        [read_recording(Path(path)).nodes["left"]["gx"] for path in status_lines["files"]]
    )
    assert len(numbers) == status_lines["nodes"]["left"]["samples"]
    steps = np.round(np.diff(numbers) / np.radians(0.07)).astype(int)
    missing = int(((steps - 1) % 0x8000).sum())
    assert missing == status_lines["nodes"]["left"]["samples_lost"], (
        "on a busy computer the line may lose some; a cut none"
    )


def test_notifications_go_to_the_socket_of_systemd_if_there_is_one(tmp_path):
    manager, now = Manager(tmp_path), [0.0]
    notifier = ServiceNotifier(
        {"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": "3000000"}, lambda: now[0]
    )
    notifier.notify_ready()
    for now[0] in np.arange(0.0, 6.0, 0.1).tolist():
        notifier.feed_watchdog()
    assert manager.listen().count("WATCHDOG=1") == 6
    ServiceNotifier(
        {"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": "1", "WATCHDOG_PID": "1"}
    ).feed_watchdog()
    assert manager.listen().count("WATCHDOG=1") == 6, "the watchdog of another process"
    manager.close()
    manager.path.unlink()
    notifier.notify_ready()
    ServiceNotifier({}).notify_ready()
    abstract = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    abstract.bind(f"\0hubodo-test-{os.getpid()}")
    ServiceNotifier({"NOTIFY_SOCKET": f"@hubodo-test-{os.getpid()}"}).notify_stopping()
    assert abstract.recv(100) == b"STOPPING=1"
    abstract.close()


def test_a_log_deleted_while_recording_is_reported_everywhere_and_the_run_fails(tmp_path):
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    Script(computer, (2.0, out.unlink))
    with FakeNode(computer=computer) as node:
        done = hubodo("record", node.path, "-o", out, "--duration", "4", "--json", computer=computer)
    assert done.code == 1
    summary = json.loads(done.out)
    assert summary["messages_lost"] > 100
    assert "was deleted or replaced while it was written" in done.err
    recording = read_recording(out)
    assert any("was deleted" in event.text for event in recording.events)
    assert recording.nodes["left"].t[0] > 1.0


def test_a_log_emptied_while_recording_is_reported_everywhere_and_the_run_fails(tmp_path):
    out, computer = tmp_path / "ride.mcap", VirtualComputer()
    Script(computer, (2.0, lambda: os.truncate(out, 0)))
    with FakeNode(computer=computer) as node:
        done = hubodo("record", node.path, "-o", out, "--duration", "4", "--json", computer=computer)
    assert done.code == 1
    summary = json.loads(done.out)
    assert summary["messages_lost"] > 100
    assert "was shortened or written to by another program" in done.err
    recording = read_recording(Path(summary["file"]))
    assert any("was shortened" in event.text for event in recording.events)
    assert recording.nodes["left"].t[0] > 1.0


def test_a_removed_folder_pauses_the_log_but_not_the_odometry_and_health_reports_it(tmp_path):
    folder, computer, snapshots = tmp_path / "logs", VirtualComputer(), []
    folder.mkdir()
    Script(computer, (4.0, lambda: folder.rename(tmp_path / "gone")))
    rows = [(0, 0, 3000, 0, 2048, 0)] * 4
    with (
        FakeNode(node_id=1, rows=rows, computer=computer) as left,
        FakeNode(node_id=2, rows=rows, computer=computer) as right,
    ):
        config, shown = RecordConfig(ports=(left.path, right.path), duration=12.0), io.StringIO()
        options = {"watch": {"test": snapshots.append}, "console": Console(file=shown, width=500)}
        result = record(config, folder / "a.mcap", vehicle=TROLLEY, computer=computer, **options)
    assert [assess_health(snapshot)[0] for snapshot in snapshots] == [True] * 4 + [False] * 8
    assert "nothing is recorded" in assess_health(snapshots[-1])[1]
    assert result.failed
    assert "folder does not exist" in result.trouble
    assert shown.getvalue().count("NOT RECORDING: ") == 1, "the line of every ten seconds"
    assert "nothing is recorded until that is over" in shown.getvalue()
    poses = [snapshot.odometry.poses for snapshot in snapshots if snapshot.odometry]
    assert (np.diff(poses) > 0).all()
    assert len(read_recording(tmp_path / "gone" / "a.mcap").nodes["left"]) > 500


class Ended:
    """A link that has ended."""

    def start(self): ...

    def send(self, data, to=""):
        return True

    def request_stop(self): ...

    def stop(self, timeout_s=0.0): ...


def test_data_queued_at_the_end_is_logged_and_decoded_within_a_time_limit(tmp_path):
    """64 nodes with 200 queued batches each; by the shutdown clock decoding one takes 5 ms."""
    computer, out = VirtualComputer(), tmp_path / "ride.mcap"
    labels = [f"n{k}" for k in range(64)]
    series = LogSeries(out, RotationRules(), computer.now_ns)
    log = LogWriter(series, t_zero_ns=computer.now_ns(), clock=None)
    recorder = Recorder(dict.fromkeys(labels), log, lambda *_: True, computer.now_ns)
    rows = ((1, 2, 3, 4, 5, 6),) * 8
    wire = [
        encode_frame(
            Frame(ImuBatch.type_id, 1, seq, encode(ImuBatch(seq * 20_000, 2_400_000, 8 * seq, 0, 0, rows)))
        )
        for seq in range(200)
    ]
    for label in labels:
        computer.put(LinkUp(label, computer.now_ns(), label, False))
    for k, frame in enumerate(wire):
        for label in labels:
            computer.put(Chunk(label, computer.now_ns() + k, frame, ""))
    ticks = iter(range(10**9))

    def now():
        return next(ticks) * 0.005

    stopping = threading.Event()
    stopping.set()
    links, events = dict.fromkeys(labels, Ended()), (stopping, threading.Event(), ServiceNotifier({}))
    loop = Loop(links, computer, recorder, None, log, series, Silent(), Silent(), *events, now)
    loop.run(None, check_fatal=False)
    assert sum(link.frames for link in recorder.links.values()) < 200
    with open_log(out) as read:
        raw = [
            decode_bytes_message("cdr", m.data) for m in read.messages() if m.topic.startswith("/hubodo/raw/")
        ]
    assert sorted(raw) == sorted(wire * 64)
    assert any("hubodo import decodes them" in event.text for event in read_recording(out).events)


def test_a_recorder_that_falls_far_behind_keeps_frames_raw_until_it_has_caught_up(tmp_path):
    """A computer reads the node with a delay of up to 30 s."""
    computer, out, late = VirtualComputer(), tmp_path / "ride.mcap", [0.0]
    put = computer.put

    def put_late(item):
        put(replace(item, t_ns=item.t_ns - int(late[0] * NS_PER_S)) if isinstance(item, Chunk) else item)

    computer.put = put_late
    Script(computer, (2.0, lambda: late.__setitem__(0, 30.0)), (4.0, lambda: late.__setitem__(0, 0.0)))
    with FakeNode(computer=computer) as node:
        result = record(RecordConfig(ports=(node.path,), duration=6.0), out, computer=computer)
    warned = [event.text for event in read_recording(out).events if event.kind == "warning"]
    assert [text.split(";")[0] for text in warned][:2] == ["30 s behind", "caught up"]
    assert 500 < result.nodes["left"]["samples"] < 900
    done = hubodo("import", out, "-o", tmp_path / "again.mcap")
    assert done.code == 0, done.err
    assert len(read_recording(tmp_path / "again.mcap").nodes["left"]) > 1200


class Silent:
    """A view or publisher without effect."""

    def show_notice(self, text): ...

    def update(self, *_): ...

    def tick(self, now_ns): ...

    def add_observer(self, part, observer): ...


def test_a_fresh_start_needs_no_room_where_it_may_wait(tmp_path):
    with pytest.raises(Exception, match="left on the disk"):
        LogSeries(tmp_path / "a.mcap", RotationRules(reserve=10**18), lambda: NS_PER_S)
    series = LogSeries(tmp_path / "a.mcap", RotationRules(reserve=10**18), lambda: NS_PER_S, wait=True)
    assert not series.is_recording
    series.rules = replace(series.rules, reserve=0)
    series.tick(2 * NS_PER_S)
    assert series.is_recording
    assert series.path == tmp_path / "a.mcap"
    series.finish()


def test_a_start_that_fails_after_its_log_began_leaves_no_log(tmp_path):
    computer = VirtualComputer()
    with socket.create_server(("127.0.0.1", 0)) as busy_socket, FakeNode(computer=computer) as node:
        words = ["record", node.path, "-o", tmp_path / "x.mcap", "--duration", "1"]
        metrics = f"127.0.0.1:{busy_socket.getsockname()[1]}"
        done = hubodo(*words, "--metrics", metrics, computer=computer)
        assert done.code == 2
        assert "choose another port" in done.err
        assert list(tmp_path.iterdir()) == []


@pytest.mark.real_time
def test_ctrl_c_while_modules_load_is_one_line_and_130(tmp_path):
    program = (
        "import signal, sys, os\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell's background job ignores it
        "from hubodo import cli, verbs\n"
        "real = cli.load_verb\n"
        "def load(verb):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    return real(verb)\n"
        "cli.load_verb = load\n"
        "sys.exit(cli.main(['record', '/dev/null', '-o', sys.argv[1]]))\n"
    )
    env = {**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"}
    words = [sys.executable, "-c", program, tmp_path / "x.mcap"]
    done = subprocess.run(words, capture_output=True, text=True, env=env)
    assert (done.returncode, len(done.stderr.splitlines())) == (130, 1)
    assert list(tmp_path.iterdir()) == []


def in_terminal(out, node, *words, hangup=signal.SIG_DFL):
    """Start a recorder on a terminal of its own; return process and terminal once its log grows."""
    child, terminal = pty.fork()
    if not child:
        signal.signal(signal.SIGHUP, hangup)
        os.environ["PYTHONPATH"] = f"{ROOT / 'host'}:{ROOT / 'protocol'}"
        program = [sys.executable, "-m", "hubodo.cli", "record", node.path, "-o", str(out), *words]
        os.execv(sys.executable, program)
    os.set_blocking(terminal, False)

    def grown():
        with contextlib.suppress(OSError):
            os.read(terminal, 65536)
        return out.exists() and out.stat().st_size > 3000

    until(grown)
    return child, terminal


@pytest.mark.real_time
@pytest.mark.parametrize("words", first_and_more(((),), (("--json", "--log-format", "json"),)))
def test_a_closed_terminal_ends_the_recording_with_a_complete_log_and_exit_code_0(tmp_path, words):
    out = tmp_path / "ride.mcap"
    with FakeNode() as node:
        child, terminal = in_terminal(out, node, *words)
        os.close(terminal)
        _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    recording = read_recording(out)
    assert recording.warnings == ()
    assert len(recording.nodes["left"]) > 10
    assert list(tmp_path.iterdir()) == [out]


@pytest.mark.real_time
def test_under_nohup_a_closed_terminal_does_not_end_the_recording(tmp_path):
    out = tmp_path / "ride.mcap"
    with FakeNode() as node:
        child, terminal = in_terminal(out, node, hangup=signal.SIG_IGN)
        os.close(terminal)
        size = out.stat().st_size
        until(lambda: out.stat().st_size > size + 6000)
        os.kill(child, signal.SIGTERM)
        _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    assert read_recording(out).warnings == ()
    assert list(tmp_path.iterdir()) == [out]
