"""Output of a running recording: on a terminal, in a journal, as JSON, and with --quiet."""

import fcntl
import io
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from fakes.fake_node import FakeNode
from fakes.script import Script
from hubodo.ingest.live import daemon
from hubodo.ingest.live.live_table import draw_snapshot
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.snapshot import LinkStatus, LogStatus, NodeStatus, OdometryStatus, Snapshot
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.units import NS_PER_S
from hubodo.vehicle import NodeMount, Vehicle
from in_process import hubodo

ROOT = Path(__file__).resolve().parents[4]
TROLLEY = Vehicle(0.3, 0.9, {"left": NodeMount("left", "left"), "right": NodeMount("right", "left")})
CONTROL_CODE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")


def record_stderr(tmp_path, width=120, terminal=True, seconds=3.0, rate_hz=208.0, faults=(), **settings):
    """Record two nodes and return the text on stderr; `faults`: (s, action on the left node)."""
    computer, shown = VirtualComputer(), io.StringIO()
    ports = [tmp_path / name for name in ("ttyL", "ttyR")]  # a pty number may be reused by another test
    console = Console(file=shown, force_terminal=terminal, width=width, height=40, legacy_windows=False)
    with (
        FakeNode(
            node_id=1,
            link=ports[0],
            rate_hz=rate_hz,
            bias_q12=(4096, -2048, 410),
            skew_ppm=400,
            computer=computer,
        ) as left,
        FakeNode(node_id=2, link=ports[1], rate_hz=rate_hz, computer=computer),
    ):
        Script(
            computer,
            *sorted(((t, lambda action=action: action(left)) for t, action in faults), key=itemgetter(0)),
        )
        config = RecordConfig(ports=(f"left={ports[0]}", f"right={ports[1]}"), duration=seconds, **settings)
        out = tmp_path / "ride.mcap"
        daemon.record(config, out, vehicle=TROLLEY, computer=computer, console=console)
    return shown.getvalue()


def without_control_codes(shown):
    return CONTROL_CODE.sub("", shown)


def test_a_terminal_shows_a_table_of_nodes_log_and_odometry_and_erases_it_at_the_end(tmp_path):
    shown = record_stderr(tmp_path, width=170)
    last = without_control_codes(shown).split("● recording ")[-1]
    (left,) = re.findall(r"● left .*", last)
    assert re.search(
        r"left +up +208\.\d +0 +26\.0 +3\.70 V +± 0\.\d\d ms +-\d+ ppm +\+0\.07 -0\.04 \+0\.01", left
    )
    assert re.search(r"● right +up +208\.\d", last)
    assert re.search(r"log +\S*ride\.mcap   [\d.]+ kB   [\d.]+ [GT]B free on disk", last)
    assert re.search(r"odometry +\d+\.\d m, -?\d+\.\d\d m/s", last)
    assert shown.count("\x1b[?25l") == shown.count("\x1b[?25h") == 1, "the cursor is shown again"
    assert shown.rstrip().endswith("\x1b[2K"), "the table is erased"
    assert set(re.findall(r"recording 0:00:0(\d)", without_control_codes(shown))) >= set("012")


def test_events_are_printed_as_lines_above_the_table(tmp_path):
    faults = ((1.0, lambda node: node.unplug()),)
    shown = without_control_codes(record_stderr(tmp_path, faults=faults))
    (line,) = re.findall("hubodo record: left: .*", shown)
    assert line.endswith("(waiting for the device)")
    assert re.search(r"● left +down", shown.split("● recording ")[-1])


def snapshot(seconds, nodes=(), size=10_000_000, free=40_000_000_000, file="ride.mcap", **more):
    log = LogStatus(
        Path(file), size, size, 1000, more.get("trouble") is None, more.get("trouble"), 1, 0, free, free
    )
    links = tuple(LinkStatus(node.link, "/dev/ttyACM0", 1, 1, 7, 7, 0, None) for node in nodes)
    odometry = OdometryStatus(1.0, 2.0, 9.0, 1.2, 0.1, 0.05, 12.3, 100)
    return Snapshot(
        (100 + seconds) * NS_PER_S, 100 * NS_PER_S, log, links, nodes, (), odometry, (3.0, 4.0), None, {}
    )


def render(status, width, colours=False):
    console = Console(file=io.StringIO(), width=width, force_terminal=colours)
    console.print(draw_snapshot(status, width))
    return console.file.getvalue()


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_no_line_of_the_table_is_wider_than_the_terminal(width):
    bias, zero = tuple(np.radians([0.1, -0.2, 10.3])), (0.0, 0.0, 0.0)
    nodes = tuple(
        NodeStatus(
            name, f"ttyACM{number}", number, 1660.0, 12.0, 9, 1, 575_000, 12_345, 0, 0.0, -49.7e-6, 0.0005,
            25.31, 3.71, bias, zero, zero, None,
        )
        for number, name in enumerate(["left", "frame-with-a-long-name"])
    )  # fmt: skip
    lines = render(snapshot(4000, nodes, file="/a/" * 20 + "ride.mcap"), width).splitlines()
    assert max(map(len, lines)) <= width
    words = " ".join(" ".join(lines).split())
    shown = (
        ["1660.0", "12345 2.1%", "silent"] + ["25.3"] * (width >= 60) + ["+0.10 -0.20 +10.30"] * (width > 110)
    )
    assert all(words.count(text) == 2 for text in shown), words
    assert "heading +156°" in words


@pytest.mark.parametrize(("age", "state"), [(0.1, "asleep"), (19.9, "asleep"), (20.1, "silent")])
def test_a_parked_node_is_shown_as_asleep_while_it_reports_every_few_seconds(age, state):
    node = NodeStatus(
        "left", "ttyACM0", 1, 0.0, age, 9, 0, 9, 0, 0, 0.0, 0.0, None, 25.3, 3.7, None, None, None, None,
        asleep=True,
    )  # fmt: skip
    assert re.search(rf"left +(ttyACM0 )?{state}", render(snapshot(60, (node,)), 100))


def test_a_disk_that_is_almost_full_is_shown_with_the_remaining_time():
    shown = render(snapshot(100, size=10_000_000, free=30_000_000), 100, colours=True)
    assert re.search(r"\x1b\[31m[^\x1b]*30 MB free on disk, enough for 0:05:00", shown)
    assert "NOT RECORDING" in render(snapshot(100, trouble="ride.mcap: disk full"), 100)
    assert "disk full" in render(snapshot(100, trouble="ride.mcap: disk full"), 100)


def test_a_journal_gets_a_line_every_ten_seconds_and_quiet_prints_only_notices(tmp_path):
    faults = ((1.0, lambda node: node.unplug()),)
    lines = record_stderr(tmp_path, terminal=False, seconds=11.0, rate_hz=52.0).splitlines()
    (line,) = [line for line in lines if re.match(r"hubodo record: \d+ s", line)]
    assert re.match(r"hubodo record: 10 s, [\d.]+ kB: left 52\.\d Hz, 0 samples lost; right 52", line)
    for terminal in (True, False):
        folder = tmp_path / f"{terminal}"
        folder.mkdir()
        quiet = record_stderr(folder, terminal=terminal, quiet=True, faults=faults, seconds=1.5)
        line, *_ = quiet.splitlines()
        assert "waiting for the device" in line and "\x1b" not in line


def test_json_output_has_one_object_per_line_with_time_level_event_and_fields(tmp_path):
    faults = ((1.0, lambda node: node.unplug()),)
    shown = record_stderr(tmp_path, seconds=11.0, rate_hz=52.0, faults=faults, log_format="json")
    entries = [json.loads(line) for line in shown.splitlines()]
    assert all(set(entry) == {"time", "level", "event", "text", "fields"} for entry in entries)
    # Fake nodes do not move as wheels do: when the odometry warns of that depends on the start of the clock.
    events = [entry for entry in entries if entry["event"] != "warning"]
    assert [entry["event"] for entry in events] == ["started", "disconnected", "status", "stopped"]
    assert entries[-1]["event"] == "stopped" and len(entries) > len(events)
    _, lost, status, _ = events
    assert (lost["level"], lost["fields"]["source"]) == ("warning", "left")
    times = np.array([np.datetime64(entry["time"].removesuffix("Z")) for entry in events])
    seconds = (times - times[0]) / np.timedelta64(1, "s")
    np.testing.assert_allclose(seconds, [0, 1, 10, 11], atol=0.15)
    (left, right), log = status["fields"]["nodes"], status["fields"]["log"]
    assert (left["name"], left["rate"], status["fields"]["links"][0]["where"]) == ("left", 0.0, None)
    assert right["rate"] == pytest.approx(52, rel=0.01)
    assert log["path"].endswith("ride.mcap") and log["disk_free"] > 0


def test_with_json_output_an_error_is_json_too(tmp_path):
    done = hubodo("record", tmp_path / "ttyNONE", "-o", tmp_path / "a.mcap", "--log-format", "json")
    (line,) = done.err.splitlines()
    entry = json.loads(line)
    assert done.code == 2 and entry["fields"] == {"exit_code": 2}
    assert (entry["level"], entry["event"]) == ("error", "failed") and "no such device" in entry["text"]


@pytest.mark.real_time
def test_ctrl_c_restores_a_real_terminal(tmp_path):
    """Run `hubodo record` in a process with a terminal of 100 columns."""
    our_end, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    environment = {
        **os.environ,
        "TERM": "xterm-256color",
        "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}",
    }
    with FakeNode() as node:
        command = [sys.executable, "-m", "hubodo.cli", "record", f"left={node.path}", "-o", "ride.mcap"]
        process = subprocess.Popen(
            command,
            cwd=tmp_path,
            env=environment,
            stdin=terminal,
            stdout=terminal,
            stderr=terminal,
            start_new_session=True,
        )
        os.close(terminal)
        shown, interrupted = b"", False
        while select.select([our_end], [], [], 60)[0]:
            try:
                shown += os.read(our_end, 65536)
            except OSError:
                break  # the process has closed its end
            if not interrupted and re.search(
                "left +up +208", without_control_codes(shown.decode(errors="ignore"))
            ):
                interrupted = True
                process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    os.close(our_end)
    text = shown.decode()
    table, _, after = text.rpartition("\x1b[2K")
    assert re.search(r"left +up +208\.\d", without_control_codes(table)) and "ride.mcap" in table
    assert "\x1b[?25l" in table and "\x1b[?25h" in text
    assert re.search(r"ride\.mcap: \d+\.\d s, \d+ messages", without_control_codes(after)), (
        "the result remains on the screen"
    )
    assert max(len(line) for line in without_control_codes(table).splitlines()) <= 100
