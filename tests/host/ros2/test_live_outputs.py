"""A recording as a ROS 2 node over Zenoh, and one whose subscriber over DDS is stopped."""

import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

import wanted
from fakes.fake_node import FakeNode
from generators.fake_drive import VEHICLE_TOML, raw_rows, short_drive
from hubodo.log.recording_reader import open_log
from in_process import hubodo

wanted.module("cyclonedds")
wanted.module("zenoh")
FAKES = Path(__file__).resolve().parents[2] / "fakes"
DOMAIN = 100 + os.getpid() % 100
# As `ros2 topic info -v /odom` prints it in ROS 2 Jazzy.
ODOMETRY_HASH = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"

pytestmark = pytest.mark.real_time


def start(*command):
    """Start another process; return it once it listens."""
    words = [sys.executable, *map(str, command)]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "ready\n"
    return process


def record(folder, *options):
    """Record two nodes for three seconds; return the result of the verb."""
    drive = short_drive(5)
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)
    with ExitStack() as stack:
        nodes = {
            name: stack.enter_context(FakeNode(node_id=number, rows=raw_rows(drive, name)))
            for number, name in ((1, "left"), (2, "right"))
        }
        ports = [f"{name}={node.path}" for name, node in nodes.items()]
        common = ("--vehicle", folder / "vehicle.toml", "--duration", 3, "--quiet", "--json")
        done = hubodo("record", *ports, "-o", folder / "ride.mcap", *common, *options)
    assert done.code == 0, done.err
    return json.loads(done.out)


def test_odometry_and_tokens_over_zenoh_have_the_form_of_rmw_zenoh(tmp_path, monkeypatch):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (tmp_path / "hubodo.toml").write_text(f'[ros2]\ndomain = 7\nrouter = "tcp/127.0.0.1:{port}"\n')
    router = start(FAKES / "zenoh_subscriber.py", port)
    record(tmp_path, "--ros2", "zenoh", "--config", tmp_path / "hubodo.toml")
    other = json.loads(router.communicate("\n")[0])
    logged = {bytes(m.data) for m in open_log(tmp_path / "ride.mcap").messages() if m.topic == "/odom"}
    assert len(other["messages"]) > 200
    assert {key for key, _, _ in other["messages"]} == {
        f"7/odom/nav_msgs::msg::dds_::Odometry_/{ODOMETRY_HASH}"
    }
    assert {bytes.fromhex(payload) for _, payload, _ in other["messages"]} <= logged
    # Attachment: sequence number, time in ns, length and bytes of the publisher's identifier.
    attachments = [struct.unpack("<qqB16s", bytes.fromhex(text)) for _, _, text in other["messages"]]
    numbers = [number for number, *_ in attachments]
    assert numbers == sorted(set(numbers)) and len({gid for *_, gid in attachments}) == 1
    tokens = [key for kind, key in other["tokens"] if kind.endswith("PUT")]
    assert any(re.fullmatch(r"@ros2_lv/7/\w+/0/0/NN/%/%/hubodo", token) for token in tokens)
    odometry = [token for token in tokens if "/MP/%/%/hubodo/%odom/" in token]
    assert odometry and odometry[0].endswith(f"/nav_msgs::msg::dds_::Odometry_/{ODOMETRY_HASH}/::,10:,:,:,,")
    # The node withdraws all of its tokens at the end.
    assert {key for kind, key in other["tokens"] if kind.endswith("DELETE")} == set(tokens)


def test_a_stopped_subscriber_leaves_the_recording_unharmed(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    subscriber = start(FAKES / "ros2_subscriber.py", DOMAIN, 60)
    os.kill(subscriber.pid, signal.SIGSTOP)
    try:
        result = record(tmp_path, "--ros2")
    finally:
        subscriber.kill()
        subscriber.communicate()
    for name in ("left", "right"):
        assert result["nodes"][name]["samples_lost"] == 0
        assert result["nodes"][name]["samples"] > 500
    assert result["faults"] == {} and result["messages_lost"] == 0
    assert result["odometry"]["poses"] > 250
