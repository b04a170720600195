"""What a recording shows while it runs: on a terminal, in a journal, as JSON, quietly."""

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

ROOT = Path(__file__).resolve().parents[2]
TROLLEY = Vehicle(0.3, 0.9, {"left": NodeMount("left", "left"), "right": NodeMount("right", "left")})
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")


def recorded(tmp_path, width=120, terminal=True, seconds=3.0, trouble=(), **settings):
    """What stderr gets from a recording of two nodes; `trouble`: (s, what is done to the left one)."""
    computer, shown = VirtualComputer(), io.StringIO()
    ends = [tmp_path / name for name in ("ttyL", "ttyR")]  # a terminal's number may be another test's next
    console = Console(file=shown, force_terminal=terminal, width=width, height=40, legacy_windows=False)
    with (
        FakeNode(
            node_id=1, link=ends[0], bias_q12=(4096, -2048, 410), skew_ppm=400, computer=computer
        ) as left,
        FakeNode(node_id=2, link=ends[1], computer=computer),
    ):
        Script(computer, *sorted(((t, lambda do=do: do(left)) for t, do in trouble), key=itemgetter(0)))
        config = RecordConfig(ports=(f"left={ends[0]}", f"right={ends[1]}"), duration=seconds, **settings)
        out = tmp_path / "ride.mcap"
        daemon.record(config, out, vehicle=TROLLEY, computer=computer, console=console)
    return shown.getvalue()


def plain(shown):
    return CONTROL.sub("", shown)


def test_a_terminal_shows_a_line_for_each_node_the_log_and_the_odometry_and_clears_it_at_the_end(tmp_path):
    shown = recorded(tmp_path, width=170)
    last = plain(shown).split("● recording ")[-1]
    (left,) = re.findall(r"● left .*", last)
    assert re.search(
        r"left +up +208\.\d +0 +26\.0 +3\.70 V +± 0\.\d\d ms +-\d+ ppm +\+0\.07 -0\.04 \+0\.01", left
    )
    assert re.search(r"● right +up +208\.\d", last)
    assert re.search(r"log +\S*ride\.mcap   [\d.]+ kB   [\d.]+ [GT]B free on disk", last)
    assert re.search(r"odometry +\d+\.\d m, -?\d+\.\d\d m/s", last)
    assert shown.count("\x1b[?25l") == shown.count("\x1b[?25h") == 1, "the cursor comes back"
    assert shown.rstrip().endswith("\x1b[2K"), "the table is gone"
    assert set(re.findall(r"recording 0:00:0(\d)", plain(shown))) >= set("012")


def test_what_happens_scrolls_by_as_a_line_that_stays(tmp_path):
    trouble = ((1.0, lambda node: node.unplug()),)
    shown = plain(recorded(tmp_path, trouble=trouble))
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


def drawn(seen, width, colours=False):
    console = Console(file=io.StringIO(), width=width, force_terminal=colours)
    console.print(draw_snapshot(seen, width))
    return console.file.getvalue()


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_no_line_of_the_table_is_wider_than_the_terminal(width):
    bias, zero = tuple(np.radians([0.1, -0.2, 10.3])), (0.0, 0.0, 0.0)
    nodes = tuple(
        NodeStatus(
            name, f"ttyACM{at}", at, 1660.0, 12.0, 9, 1, 575_000, 12_345, 0, 0.0, -49.7e-6, 0.0005,
            25.31, 3.71, bias, zero, zero, None,
        )
        for at, name in enumerate(["left", "frame-with-a-long-name"])
    )  # fmt: skip
    lines = drawn(snapshot(4000, nodes, file="/a/" * 20 + "ride.mcap"), width).splitlines()
    assert max(map(len, lines)) <= width
    words = " ".join(" ".join(lines).split())
    shown = (
        ["1660.0", "12345 2.1%", "silent"] + ["25.3"] * (width >= 60) + ["+0.10 -0.20 +10.30"] * (width > 110)
    )
    assert all(words.count(text) == 2 for text in shown), words
    assert "heading +156°" in words


def test_a_disk_that_is_about_to_be_full_is_shown_with_the_time_it_lasts():
    shown = drawn(snapshot(100, size=10_000_000, free=30_000_000), 100, colours=True)
    assert re.search(r"\x1b\[31m[^\x1b]*30 MB free on disk, enough for 0:05:00", shown)
    assert "NOT RECORDING" in drawn(snapshot(100, trouble="ride.mcap: disk full"), 100)
    assert "disk full" in drawn(snapshot(100, trouble="ride.mcap: disk full"), 100)


def test_a_journal_gets_a_line_every_ten_seconds_and_quiet_nothing_but_notices(tmp_path):
    trouble = ((1.0, lambda node: node.unplug()),)
    lines = recorded(tmp_path, terminal=False, seconds=11.0).splitlines()
    (line,) = [line for line in lines if re.match(r"hubodo record: \d+ s", line)]
    assert re.match(r"hubodo record: 10 s, [\d.]+ kB: left 208\.\d Hz, 0 samples lost; right 208", line)
    for terminal in (True, False):
        folder = tmp_path / f"{terminal}"
        folder.mkdir()
        quiet = recorded(folder, terminal=terminal, quiet=True, trouble=trouble, seconds=1.5)
        line, *_ = quiet.splitlines()
        assert "waiting for the device" in line and "\x1b" not in line


def test_json_is_an_object_a_line_with_time_level_event_and_fields(tmp_path):
    trouble = ((1.0, lambda node: node.unplug()),)
    shown = recorded(tmp_path, seconds=11.0, trouble=trouble, log_format="json")
    said = [json.loads(line) for line in shown.splitlines()]
    assert all(set(one) == {"time", "level", "event", "text", "fields"} for one in said)
    assert [one["event"] for one in said] == [
        "started",
        "disconnected",
        "status",
        *["warning"] * (len(said) - 4),
        "stopped",
    ]
    lost, status = said[1], said[2]
    assert (lost["level"], lost["fields"]["source"]) == ("warning", "left")
    times = np.array([np.datetime64(one["time"].removesuffix("Z")) for one in said])
    seconds = (times - times[0]) / np.timedelta64(1, "s")
    np.testing.assert_allclose(seconds[[0, 1, 2, -1]], [0, 1, 10, 11], atol=0.15)
    (left, right), log = status["fields"]["nodes"], status["fields"]["log"]
    assert (left["name"], left["rate"], status["fields"]["links"][0]["where"]) == ("left", 0.0, None)
    assert right["rate"] == pytest.approx(208, rel=0.01)
    assert log["path"].endswith("ride.mcap") and log["disk_free"] > 0


def test_an_error_is_json_too_where_json_is_asked_for(tmp_path):
    done = hubodo("record", tmp_path / "ttyNONE", "-o", tmp_path / "a.mcap", "--log-format", "json")
    (line,) = done.err.splitlines()
    said = json.loads(line)
    assert done.code == 2 and said["fields"] == {"exit_code": 2}
    assert (said["level"], said["event"]) == ("error", "failed") and "no such device" in said["text"]


@pytest.mark.real_time
def test_on_a_real_terminal_ctrl_c_leaves_it_as_it_was(tmp_path):
    """`hubodo record` in a process whose terminal is 100 columns wide."""
    near, far = pty.openpty()
    fcntl.ioctl(far, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    environment = {
        **os.environ,
        "TERM": "xterm-256color",
        "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}",
    }
    with FakeNode() as node:
        command = [sys.executable, "-m", "hubodo.cli", "record", f"left={node.path}", "-o", "ride.mcap"]
        process = subprocess.Popen(
            command, cwd=tmp_path, env=environment, stdin=far, stdout=far, stderr=far, start_new_session=True
        )
        os.close(far)
        shown, asked = b"", False
        while select.select([near], [], [], 60)[0]:
            try:
                shown += os.read(near, 65536)
            except OSError:
                break  # the process has closed its end
            if not asked and re.search("left +up +208", plain(shown.decode(errors="ignore"))):
                asked = True
                process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    os.close(near)
    text = shown.decode()
    table, _, after = text.rpartition("\x1b[2K")
    assert re.search(r"left +up +208\.\d", plain(table)) and "ride.mcap" in table
    assert "\x1b[?25l" in table and "\x1b[?25h" in text
    assert re.search(r"ride\.mcap: \d+\.\d s, \d+ messages", plain(after)), "the result stays"
    assert max(len(line) for line in plain(table).splitlines()) <= 100
