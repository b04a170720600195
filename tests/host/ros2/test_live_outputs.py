"""A recording as a ROS 2 node over Zenoh, and one whose subscriber over DDS is stopped."""

import os
import re
import signal
import socket
import struct
from dataclasses import replace

import pytest

import wanted
from hubodo.log.recording_reader import open_log
from hubodo.ros2.config import Ros2Config, complete_config, load_ros2_config
from live_rides import OtherProcess, record_ride

wanted.module("cyclonedds")
wanted.module("zenoh")
DOMAIN = 100 + os.getpid() % 100
# As `ros2 topic info -v /odom` prints it in ROS 2 Jazzy.
ODOMETRY_HASH = "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"

pytestmark = pytest.mark.real_time


def test_odometry_and_tokens_over_zenoh_have_the_form_of_rmw_zenoh(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (tmp_path / "hubodo.toml").write_text(f'[ros2]\ndomain = 7\nrouter = "tcp/127.0.0.1:{port}"\n')
    router = OtherProcess("zenoh_subscriber.py", port)
    config = replace(load_ros2_config(tmp_path / "hubodo.toml"), publish="zenoh")
    record_ride(tmp_path, complete_config(config), router.has_received)
    other = router.result()
    logged = {bytes(m.data) for m in open_log(tmp_path / "ride.mcap").messages() if m.topic == "/odom"}
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
    assert odometry and odometry[0].endswith(f"/nav_msgs::msg::dds_::Odometry_/{ODOMETRY_HASH}/::,100:,:,:,,")
    # The node withdraws all of its tokens at the end.
    assert {key for kind, key in other["tokens"] if kind.endswith("DELETE")} == set(tokens)


def test_a_stopped_subscriber_leaves_the_recording_unharmed(tmp_path):
    subscriber = OtherProcess("ros2_subscriber.py", DOMAIN).process
    os.kill(subscriber.pid, signal.SIGSTOP)
    try:
        result = record_ride(tmp_path, complete_config(Ros2Config(publish="dds", domain=DOMAIN)))
    finally:
        subscriber.kill()
        subscriber.wait()
    for name in ("left", "right"):
        assert result["nodes"][name]["samples_lost"] == 0
        assert result["nodes"][name]["samples"] > 500
    assert result["faults"] == {} and result["messages_lost"] == 0
    assert result["odometry"]["poses"] > 250
