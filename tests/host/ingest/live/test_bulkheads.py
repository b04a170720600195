"""An exception or hang of any part of a recording affects that part only."""

import threading
import time
from contextlib import ExitStack
from functools import partial

import numpy as np
import pytest
from rich.console import Console

from fakes.fake_node import FakeNode
from fakes.fake_receiver import fake_receiver
from generators.fake_drive import VEHICLE_TOML, raw_rows, short_drive
from generators.gnss_drives import geodetic
from hubodo.ingest.gnss.session import GnssSession
from hubodo.ingest.link.session import LinkSession
from hubodo.ingest.live import daemon, take_snapshot, view
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.localizer import Localizer
from hubodo.ingest.live.metrics import metrics_text
from hubodo.ingest.live.metrics_server import MetricsServer
from hubodo.ingest.live.notify import ServiceNotifier
from hubodo.ingest.live.odometer import Odometer
from hubodo.ingest.live.output_thread import OutputThread
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.ingest.node.session import NodeSession
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import read_recording
from hubodo.vehicle import load_vehicle
from hubodo.web.address import Address
from hubodo.web.live_page import LivePage
from hubodo.web.log_observer import LogObserver
from hubowire import decode
from in_process import hubodo

SECONDS, RATE_HZ, ORIGIN = 2.0, 104.0, (47.0, 8.0)


class Injected(Exception):
    """The exception raised by the part under test."""


def of_left(original, fault):
    """Return a method that faults for the node, link or name `left` and works for all others."""

    def method(self, *args, **kwargs):
        if "left" in (getattr(self, "name", None), getattr(self, "label", None)):
            fault()
        return original(self, *args, **kwargs)

    return method


def always(original, fault):
    def method(*args, **kwargs):
        fault()

    return method


PARTS = {
    "frames of a node": (NodeSession, "handle_frame", of_left, "node left"),
    "ticks of a node": (NodeSession, "tick", of_left, "node left"),
    "bytes of a link": (LinkSession, "route_frames", of_left, "link left"),
    "ticks of a link": (LinkSession, "tick", of_left, "link left"),
    "odometry": (Odometer, "handle", always, "odometry"),
    "a receiver": (GnssSession, "handle_bytes", always, "receiver gnss"),
    "the graph": (Localizer, "add_pose", always, "map"),
    "a table or lines": (view.LineView, "show", always, "terminal"),
    "what is shown at once": (view.LineView, "show_notice", always, "terminal"),
    "JSON lines": (view.JsonView, "_write_line", always, "terminal"),
    "the page": (LivePage, "poll", always, "page"),
    "what the page follows": (LogObserver, "observe", always, "page"),
    "the page's status": (LivePage, "show", always, "page"),
    "metrics": (MetricsServer, "show", always, "metrics"),
    "the service manager": (ServiceNotifier, "show", always, "service manager"),
    "the status": (take_snapshot, "memory_in_use", always, "status"),
}
HURTS_LEFT = {"frames of a node", "ticks of a node", "bytes of a link", "ticks of a link"}


def injected(monkeypatch, kind, fault):
    """Put a fault into every call of a part; return the part's name in events and metrics."""
    owner, method, where, part = PARTS[kind]
    monkeypatch.setattr(owner, method, where(getattr(owner, method), fault))
    return part


def east(seconds):
    latitude, longitude = geodetic(np.array([seconds]), np.array([0.0]), *ORIGIN)
    return float(latitude[0]), float(longitude[0]), 0.5


def recording(folder, nodes, stack, computer=None, seconds=SECONDS, log_format="text", page=None, **settings):
    """Record two nodes with everything enabled; return the result, the snapshots and the output."""
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)
    shown, snapshots = (folder / "shown.txt").open("w"), []
    stack.callback(shown.close)
    config = RecordConfig(
        ports=tuple(f"{name}={node.path}" for name, node in nodes.items()),
        duration=seconds,
        metrics="127.0.0.1:0",
        log_format=log_format,
        **settings,
    )
    page = page or LivePage(lambda frame: None)
    page.startup_lines = ["live page at a place"]
    result = record(
        config,
        folder / "ride.mcap",
        vehicle=load_vehicle(folder / "vehicle.toml"),
        computer=computer,
        console=Console(file=shown, width=300),
        watch={"test": snapshots.append},
        audience=page,
    )
    shown.flush()
    return result, snapshots, (folder / "shown.txt").read_text()


def drive_nodes(stack, computer, rate_hz=RATE_HZ):
    drive = short_drive(5)
    nodes = {
        name: FakeNode(node_id=number, rows=raw_rows(drive, name), computer=computer, rate_hz=rate_hz)
        for number, name in ((1, "left"), (2, "right"))
    }
    for node in nodes.values():
        stack.enter_context(node)
    return nodes


def intact(result, name, node):
    """Return True if all samples of a node were decoded."""
    node_result = result.nodes[name]
    assert (node_result["samples_lost"], node_result["frames_unread"], node_result["gaps"], node.dropped) == (
        0,
        0,
        {},
        0,
    )
    return node_result["samples"]


@pytest.mark.parametrize("kind", PARTS)
def test_a_part_that_raises_at_every_call_loses_no_sample_of_the_others(tmp_path, monkeypatch, kind):
    def fault():
        raise Injected("by the test")

    computer = VirtualComputer()
    with ExitStack() as stack:
        nodes = drive_nodes(stack, computer)
        receiver = stack.enter_context(fake_receiver(computer, east))
        part = injected(monkeypatch, kind, fault)
        log_format = "json" if kind == "JSON lines" else "text"
        result, snapshots, shown = recording(
            tmp_path, nodes, stack, computer, gnss=receiver.path, log_format=log_format
        )
    assert intact(result, "right", nodes["right"]) > RATE_HZ * (SECONDS - 0.2)
    log = read_recording(tmp_path / "ride.mcap")
    assert len(log.nodes["right"]) == result.nodes["right"]["samples"]
    if kind not in HURTS_LEFT:
        assert intact(result, "left", nodes["left"]) == len(log.nodes["left"])
    faults = [event for event in log.events if event.kind == "fault"]
    assert {event.source for event in faults} == {part}
    assert "Injected: by the test" in faults[0].text
    assert sum(event.data["new"] for event in faults) == faults[-1].data["total"]
    if part not in ("terminal", "status"):
        assert snapshots[-1].faults[part] > 0
        assert f'hubodo_faults_total{{part="{part}"}}' in metrics_text(snapshots[-1]).decode()
        assert f"{part}: Injected: by the test" in shown


def test_the_bytes_that_a_node_failed_on_are_in_the_event_and_its_frames_are_in_the_log(
    tmp_path, monkeypatch
):
    def fault():
        raise Injected("by the test")

    computer = VirtualComputer()
    with ExitStack() as stack:
        nodes = drive_nodes(stack, computer)
        injected(monkeypatch, "frames of a node", fault)
        recording(tmp_path, nodes, stack, computer)
    monkeypatch.undo()
    (event, *_) = (event for event in read_recording(tmp_path / "ride.mcap").events if event.kind == "fault")
    frame = bytes.fromhex(event.data["cause"])
    assert frame[1] == 1, "the node's number"
    assert decode(frame[0], frame[2:]) == nodes["left"].hello(), "the first that it failed on"
    assert event.data["place"].startswith("test_bulkheads.py:")
    again = hubodo("import", tmp_path / "ride.mcap", "-o", tmp_path / "again.mcap")
    assert again.code == 0, again.err
    assert len(read_recording(tmp_path / "again.mcap").nodes["left"]) > RATE_HZ * (SECONDS - 0.2)


def sleeps():
    time.sleep(3600)


def spins():
    while True:
        pass


HANGING = (
    ("frames of a node", spins),
    ("bytes of a link", sleeps),
    ("odometry", spins),
    ("the page", sleeps),
    ("what the page follows", sleeps),
    ("metrics", sleeps),
    ("the status", sleeps),
    ("a table or lines", sleeps),
    ("what is shown at once", sleeps),
)


@pytest.mark.real_time
@pytest.mark.parametrize(("kind", "fault"), HANGING)
def test_a_part_that_hangs_at_every_call_loses_no_sample_of_the_others(tmp_path, monkeypatch, kind, fault):
    monkeypatch.setattr(daemon, "Bulkheads", partial(Bulkheads, hang_timeout_s=0.3))
    with ExitStack() as stack:
        nodes = drive_nodes(stack, None, rate_hz=416.0)
        part = injected(monkeypatch, kind, fault)
        result, *_ = recording(tmp_path, nodes, stack, seconds=1.5)
        assert intact(result, "right", nodes["right"]) > 0
    faults = [e for e in read_recording(tmp_path / "ride.mcap").events if e.kind == "fault"]
    if part != "terminal":  # which runs in a thread with a limit of five seconds
        assert {event.source for event in faults} == {part}
        assert "no return within 0.3 s; interrupted" in faults[0].text
        assert faults[0].data["total"] == 1, "suspended for a second, not called again at once"


@pytest.mark.parametrize("fault", [sleeps, None])
def test_a_foxglove_server_that_raises_or_hangs_loses_no_sample(tmp_path, monkeypatch, fault):
    pytest.importorskip("foxglove")
    from hubodo.web.foxglove_live import FoxgloveLive

    def raises(*_):
        raise Injected("by the test")

    monkeypatch.setattr(FoxgloveLive, "_write", (lambda *_: fault()) if fault else raises)
    computer = VirtualComputer()
    with ExitStack() as stack:
        nodes = drive_nodes(stack, computer)
        live = stack.enter_context(FoxgloveLive(Address("127.0.0.1", 0)))
        result, *_ = recording(tmp_path, nodes, stack, computer, page=LivePage(lambda frame: None, live))
    for name, node in nodes.items():
        assert intact(result, name, node) > RATE_HZ * (SECONDS - 0.2)
    faults = [
        event.source for event in read_recording(tmp_path / "ride.mcap").events if event.kind == "fault"
    ]
    assert set(faults) == (set() if fault else {"foxglove"}), "a hang is found after five seconds"


class Clock:
    """A host clock advanced by the test."""

    def __init__(self):
        self.now_ns = 0

    def __call__(self):
        return self.now_ns


def raising():
    raise Injected("again")


def test_a_fault_is_reported_at_once_and_then_every_ten_seconds_with_its_count():
    clock = Clock()
    bulkheads = Bulkheads(clock)
    reports = []
    for _ in range(1000):
        assert not bulkheads.run("node left", raising, cause=b"\x02\x01abc")
        reports += bulkheads.due_reports()
        clock.now_ns += 25_000_000
    reports += bulkheads.due_reports(final=True)
    assert [event.data["new"] for event in reports] == [1, 400, 400, 199]
    assert reports[-1].data["total"] == bulkheads.fault_counts()["node left"] == 1000
    assert reports[0].data["cause"] == "0201616263"


def test_a_suspended_part_is_tried_again_after_pauses_that_double_up_to_a_minute():
    clock = Clock()
    bulkheads, tried = Bulkheads(clock), []

    def fails():
        tried.append(clock.now_ns // 1_000_000_000)
        raising()

    for _ in range(300):
        bulkheads.run("page", fails, pausing=True)
        clock.now_ns += 1_000_000_000
    assert tried == [0, 1, 3, 7, 15, 31, 63, 123, 183, 243]
    assert bulkheads.run("page", lambda: None) is False, "still suspended"
    clock.now_ns += 60_000_000_000
    assert bulkheads.run("page", lambda: None) is True
    bulkheads.run("page", fails, pausing=True)
    clock.now_ns += 1_000_000_000
    assert bulkheads.run("page", lambda: None) is True, "a success has ended the row of faults"


def test_a_fault_is_attributed_to_the_innermost_part():
    bulkheads, done = Bulkheads(Clock()), []

    def outer():
        bulkheads.run("odometry", raising)
        done.append("outer")

    assert bulkheads.run("node left", outer)
    assert (done, bulkheads.fault_counts()) == (["outer"], {"odometry": 1})


def test_the_log_is_never_interrupted():
    bulkheads, ended = Bulkheads(time.time_ns, hang_timeout_s=0.1), []

    def writes():
        with bulkheads.protect_write():
            time.sleep(0.5)
            ended.append("written")
        time.sleep(3600)

    with bulkheads.watch_for_hangs():
        assert not bulkheads.run("node left", writes)
    assert ended == ["written"]


def test_a_stalled_output_thread_is_replaced_and_its_late_return_ignored():
    stalled, handled = threading.Event(), []
    bulkheads = Bulkheads(lambda: 0)
    threads = iter(range(100))

    def make_handler():
        number = next(threads)

        def handle(item):
            if number == 0:
                stalled.wait()
            handled.append((number, item))

        return handle

    output = OutputThread("map", make_handler, bulkheads, replaceable=True)
    output.put("first")
    until_busy(output)
    while not bulkheads.fault_counts():
        output._next_check = 0.0
        output.check_stall()
    assert bulkheads.fault_counts() == {"map": 1}
    bulkheads._now_ns = lambda: 10**12
    output.put("second")
    assert output.close(60.0)
    stalled.set()
    assert handled[0] == (1, "second")


def until_busy(output):
    while not output._is_busy:
        time.sleep(0.001)


def test_a_full_mailbox_drops_the_oldest_and_counts_them():
    released, handled = threading.Event(), []

    def handle(item):
        released.wait()
        handled.append(item)

    output = OutputThread("page", lambda: handle, Bulkheads(lambda: 0), capacity=3)
    output.put(0)
    until_busy(output)
    for item in range(1, 8):
        output.put(item)
    released.set()
    assert output.close(60.0)
    assert (handled, output.dropped) == ([0, 5, 6, 7], 4)


def test_a_log_that_cannot_be_written_ends_the_recording_and_stays_readable(tmp_path, monkeypatch):
    computer, written = VirtualComputer(), []

    def until_the_disk_breaks(original):
        def method(self, *args):
            written.append(args)
            if len(written) > 100:
                raise Injected("the writer")
            original(self, *args)

        return method

    for name in ("write_imu", "write_event"):
        monkeypatch.setattr(LogWriter, name, until_the_disk_breaks(getattr(LogWriter, name)))
    with ExitStack() as stack:
        nodes = drive_nodes(stack, computer, rate_hz=208.0)
        with pytest.raises(Injected, match="the writer"):
            recording(tmp_path, nodes, stack, computer)
    monkeypatch.undo()
    recovered = hubodo("recover", tmp_path / "ride.mcap", "-o", tmp_path / "whole.mcap")
    path = tmp_path / ("whole.mcap" if recovered.code == 0 else "ride.mcap")
    assert sum(map(len, read_recording(path).nodes.values())) > 100
