"""Services of a ROS 2 node, called by other processes over DDS and Zenoh in the form of ROS 2 itself."""

from __future__ import annotations

import contextlib
import json
import math
import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import wanted
from hubodo.ingest.live.odometry_requests import FindBias, OdometryRequest, SetPose
from hubodo.ingest.live.ros2_services import Ros2Services
from hubodo.ros2.cdr import decode_message
from hubodo.ros2.config import Ros2Config, TransportName, complete_config
from hubodo.ros2.transport import open_node

wanted.module("cyclonedds")
wanted.module("zenoh")
FAKES = Path(__file__).resolve().parents[2] / "fakes"
DOMAIN = 100 + os.getpid() % 100

pytestmark = pytest.mark.real_time


@contextlib.contextmanager
def served(transport: TransportName, config: Ros2Config) -> Iterator[list[OdometryRequest]]:
    """Serve requests that succeed at once; yield the list to which they are added."""
    requests: list[OdometryRequest] = []

    def put(request: OdometryRequest) -> None:
        requests.append(request)
        request.on_outcome(True, "left: done")

    node = open_node(transport, complete_config(config))
    Ros2Services(node, "hubodo", put, time.time_ns, lambda action: action()).start()
    try:
        yield requests
    finally:
        node.close()


def test_services_and_topics_are_called_over_dds_and_the_replies_name_their_requests() -> None:
    with served("dds", Ros2Config(domain=DOMAIN)) as requests:
        command = [sys.executable, str(FAKES / "ros2_client.py"), str(DOMAIN)]
        other = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    pose, bias, reset = requests
    assert isinstance(pose, SetPose) and isinstance(bias, FindBias) and isinstance(reset, SetPose)
    assert (pose.x, pose.y, pose.heading) == pytest.approx((3.0, -2.0, 2.0 * math.atan2(0.6, 0.8)))
    assert pose.covariance.tolist() == [[0, 1, 5], [6, 7, 11], [30, 31, 35]]
    assert (reset.source, reset.x, reset.y) == ("topic /hubodo/reset", 0.0, 0.0)
    assert np.all(reset.covariance == 0.0)
    client = 0x0123456789ABCDEF
    (reply,) = other["replies"]["set_pose"]
    assert (reply["client_guid"], reply["sequence_number"]) == (client, 7)
    (reply,) = other["replies"]["find_bias"]
    assert (reply["client_guid"], reply["sequence_number"]) == (client, 8)
    assert (reply["success"], reply["message"]) == (True, "left: done")
    # rmw_cyclonedds counts a service as available once endpoints with one `serviceid` are matched.
    assert other["user_data"]["rq/hubodo/find_biasRequest"].startswith("serviceid=")


def test_services_are_called_over_zenoh_and_listed_in_the_graph() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, str(FAKES / "zenoh_client.py"), str(port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout is not None and client.stdout.readline() == "ready\n"
        with served("zenoh", Ros2Config(domain=7, router=f"tcp/127.0.0.1:{port}")) as requests:
            other = json.loads(client.communicate("\n", timeout=600)[0])
    assert [type(request) for request in requests] == [FindBias]
    ((key, payload, attachment),) = other["replies"]
    assert key.startswith("7/hubodo/find_bias/std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6")
    response = decode_message("std_srvs/srv/Trigger_Response", bytes.fromhex(payload))
    assert response == {"success": True, "message": "left: done"}
    # The reply carries number and client of the request.
    number, _, length, gid = struct.unpack("<qqB16s", bytes.fromhex(attachment))
    assert (number, length, gid) == (42, 16, bytes(range(16)))
    names = {token.split("/")[9] for token in other["tokens"]}
    assert names == {"%hubodo%reset", "%hubodo%set_pose", "%hubodo%find_bias"}
