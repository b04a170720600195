"""A recording whose standard error or output is not read continues, and ends on request."""

import fcntl
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from fakes.fake_node import FakeNode
from hubodo.ingest.live.timeout_stream import TimeoutStream
from hubodo.log.recording_reader import read_recording
from repetitions import first_and_more
from waiting import until

ROOT = Path(__file__).resolve().parents[4]
pytestmark = pytest.mark.real_time


def full_pipe():
    """Return a full pipe: its reading and its writing end."""
    reading, writing = os.pipe()
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 8192)
    os.set_blocking(writing, False)
    with suppress(BlockingIOError):
        while True:
            os.write(writing, b"x")
    os.set_blocking(writing, True)
    return reading, writing


def recorder(out, node, *words, **streams):
    command = [sys.executable, "-m", "hubodo.cli", "record", node.path, "-o", str(out), *words]
    env = {**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"}
    return subprocess.Popen(command, env=env, **streams)


@pytest.mark.parametrize("log_format", first_and_more("text", "json"))
def test_a_hanging_reader_blocks_neither_the_log_nor_the_exit(tmp_path, log_format):
    out, (reading, writing) = tmp_path / "a.mcap", full_pipe()
    with FakeNode(rate_hz=416.0) as node:
        words = ("--log-format", log_format, "--metrics", "127.0.0.1:0")
        process = recorder(out, node, *words, stdout=writing, stderr=writing)
        until(lambda: out.exists() and out.stat().st_size > 50_000)
        process.send_signal(signal.SIGTERM)
        process.wait(60)
    os.close(reading)
    os.close(writing)
    assert process.returncode == 0
    assert not [event for event in read_recording(out).events if event.kind == "gap"]


def test_a_closed_reader_does_not_end_the_recording(tmp_path):
    out, (reading, writing) = tmp_path / "a.mcap", os.pipe()
    os.close(reading)
    with FakeNode(rate_hz=416.0) as node:
        words = ("--log-format", "json", "--duration", "2")
        process = recorder(out, node, *words, stdout=subprocess.DEVNULL, stderr=writing)
        process.wait(60)
    os.close(writing)
    assert process.returncode == 0
    log = read_recording(out)
    assert len(log.nodes["left"]) > 600
    assert [event.source for event in log.events if event.kind == "fault"] == ["terminal"]


def test_the_log_does_not_use_descriptors_of_closed_standard_streams(tmp_path):
    out = tmp_path / "a.mcap"
    with FakeNode() as node:
        command = f'exec "{sys.executable}" -m hubodo.cli record {node.path} -o {out} --duration 1 >&- 2>&-'
        env = {**os.environ, "PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}"}
        assert subprocess.run(["/bin/sh", "-c", command], env=env).returncode == 0
    assert len(read_recording(out).nodes["left"]) > 100


def test_a_line_that_was_cut_off_is_completed_before_the_next():
    reading, writing = full_pipe()
    stream = TimeoutStream(writing, timeout_s=0.01)
    os.set_blocking(reading, False)
    os.read(reading, 4096)
    with pytest.raises(TimeoutError, match="was not read"):
        stream.write("a" * 700 + "\n")
    with pytest.raises(TimeoutError):
        stream.write("dropped\n")
    received = os.read(reading, 1 << 20)
    stream.write("next\n")
    received += os.read(reading, 1 << 20)
    assert received.lstrip(b"x") == b"a" * 700 + b"\nnext\n"
    os.close(reading)
    os.close(writing)
