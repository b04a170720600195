"""A port `ros2:/topic` over Zenoh: messages and the presence of a publisher in another process."""

import json
import queue
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import wanted
from hubodo.errors import LinkError
from hubodo.ingest.link.link import LinkLost, LinkUp, TopicMessage
from hubodo.ingest.topic.link import TopicLink
from hubodo.ingest.topic.port import TopicPort
from hubodo.log import ros2
from hubodo.ros2.cdr import encode_message
from hubodo.ros2.config import Ros2Config, complete_config

wanted.module("zenoh")
FAKES = Path(__file__).resolve().parents[3] / "fakes"
PORT = TopicPort("left", "/left_wheel/imu", "node")

pytestmark = pytest.mark.real_time


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def topic_link(port, topic=PORT):
    """Return a link over Zenoh and the queue of its reports."""
    reports = queue.Queue()
    config = complete_config(Ros2Config(transport="zenoh", domain=7, router=f"tcp/127.0.0.1:{port}"))
    return TopicLink(topic, reports, time.monotonic_ns, time.time_ns, config), reports


def reports_until(reports, kind):
    """Return the reports up to the first of a kind."""
    received = [reports.get(timeout=300)]
    while not isinstance(received[-1], kind):
        received.append(reports.get(timeout=300))
    return received


def test_messages_arrive_unaltered_and_the_link_is_up_while_there_is_a_publisher(tmp_path):
    port, path = free_port(), tmp_path / "payloads.json"
    payloads = [
        encode_message(ros2.IMU, {"header": {"stamp": {"sec": 1000 + n}, "frame_id": "wheel"}})
        for n in range(100)
    ]
    path.write_text(json.dumps([payload.hex() for payload in payloads]))
    command = [sys.executable, str(FAKES / "zenoh_publisher.py"), str(port), str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout.readline() == "ready\n"
        link, reports = topic_link(port)
        try:
            link.open_now()
            link.start()
            *before, up = reports_until(reports, LinkUp)
            assert all("nobody publishes it" in report.text for report in before)
            assert up.endpoint == "ros2:/left_wheel/imu (sensor_msgs/msg/Imu)"
            wrong = topic_link(port, TopicPort("gnss", "/left_wheel/imu", "gnss"))[0]
            with pytest.raises(LinkError, match="write NAME=ros2:/left_wheel/imu"):
                wrong.open_now()
            wrong.stop()
            driver.stdin.write("\n")
            driver.stdin.flush()
            received = [reports.get(timeout=300) for _ in payloads]
            assert all(isinstance(report, TopicMessage) for report in received)
            assert [report.payload for report in received] == payloads
            driver.stdin.write("\n")
            driver.stdin.flush()
            (lost,) = reports_until(reports, LinkLost)
            assert "nobody publishes it in domain 7" in lost.text
        finally:
            link.stop()
