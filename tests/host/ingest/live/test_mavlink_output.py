"""Odometry as MAVLink, received by the parser of pymavlink from a socket."""

import math
import socket
import time

import numpy as np
import pytest

import wanted
from hubodo.errors import InputError
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.mavlink_output import MavlinkOutput, mavlink_output, parse_mavlink_address
from hubodo.ingest.live.snapshot import LogStatus, Snapshot
from hubodo.log.records import Odometry
from hubodo.vehicle import load_vehicle
from vehicles import vehicle_toml

wanted.module("pymavlink")
TRACK = 0.5
START_NS = 1_790_000_000_000_000_000


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(5.0)
        yield listening


@pytest.fixture
def vehicle(tmp_path):
    (tmp_path / "v.toml").write_text(vehicle_toml(0.15, TRACK))
    return load_vehicle(tmp_path / "v.toml")


def receive(listening, count):
    """Return messages parsed by pymavlink, which checks checksum, length and type."""
    from pymavlink.dialects.v20 import common

    parser, messages = common.MAVLink(None), []
    while len(messages) < count:
        messages += parser.parse_buffer(listening.recv(4096)) or []
    return messages


def circle(numbers, covariance=None):
    """Return rows at 100 Hz of a left turn at 1 m/s and 0.5 rad/s."""
    t = 0.01 * np.asarray(numbers)
    heading, ones = 0.5 * t, np.ones(len(t))
    position = 2.0 * np.column_stack([np.sin(heading), 1.0 - np.cos(heading)])
    pose = np.tile(np.array([[0.04, 0.01, 0.002], [0.01, 0.09, 0.003], [0.002, 0.003, 0.01]]), (len(t), 1, 1))
    twist = np.tile(np.array([[0.01, 0.001], [0.001, 0.02]]), (len(t), 1, 1))
    t_ns = START_NS + np.round(t * 1e9).astype(np.int64)
    return Odometry(t_ns, 0, position, heading, ones, 0.5 * ones, pose, twist)


def test_odometry_has_axes_forward_right_down_and_wheels_their_distances(receiver, vehicle):
    output = MavlinkOutput(receiver.getsockname(), vehicle)
    listener = output.attach(Bulkheads(time.monotonic_ns))
    for first in range(0, 400, 4):
        listener(circle(range(first, first + 4)))
    messages = receive(receiver, 200)
    output.close()
    odometry = [message for message in messages if message.get_type() == "ODOMETRY"]
    wheels = [message for message in messages if message.get_type() == "WHEEL_DISTANCE"]
    assert len(odometry) == len(wheels) == 100
    last, t = odometry[-1], 3.99
    assert last.time_usec == START_NS // 1000 + 3_990_000
    assert (last.frame_id, last.child_frame_id) == (20, 12)  # LOCAL_FRD, BODY_FRD
    assert (last.x, last.y, last.z) == pytest.approx(
        (2 * math.sin(0.5 * t), -2 * (1 - math.cos(0.5 * t)), 0.0), abs=1e-5
    )
    assert last.q == pytest.approx([math.cos(0.25 * t), 0, 0, -math.sin(0.25 * t)], abs=1e-6)
    assert (last.vx, last.yawspeed) == pytest.approx((1.0, -0.5))
    pose = last.pose_covariance
    # Upper triangle: x, y and yaw are rows 0, 1 and 5; y and yaw change sign.
    assert [pose[n] for n in (0, 1, 5, 6, 10, 20)] == pytest.approx([0.04, -0.01, -0.002, 0.09, 0.003, 0.01])
    assert [last.velocity_covariance[n] for n in (0, 5, 20)] == pytest.approx([0.01, -0.001, 0.02])
    # A left turn: the left wheel is on the inner circle of radius 2 m - 0.25 m.
    assert wheels[-1].count == 2
    assert wheels[-1].distance[:2] == pytest.approx([1.75 * 0.5 * t, 2.25 * 0.5 * t], rel=1e-9)


def test_a_heartbeat_is_sent_with_each_snapshot(receiver, vehicle, tmp_path):
    output = MavlinkOutput(receiver.getsockname(), vehicle)
    output.attach(Bulkheads(time.monotonic_ns))
    log = LogStatus(tmp_path, 0, 0, 0, True, None, 1, 0, None, None)
    output.show(Snapshot(START_NS, START_NS, log, (), (), (), None, None, None, {}))
    (beat,) = receive(receiver, 1)
    output.close()
    assert beat.get_type() == "HEARTBEAT" and (beat.type, beat.autopilot, beat.system_status) == (18, 8, 4)
    assert (beat.get_srcSystem(), beat.get_srcComponent()) == (1, 197)


@pytest.mark.parametrize("text", ["", "udpout:", "udpout:host", "udpout:host:0", "tcp:host:1", "udpout::5"])
def test_addresses_of_another_form_are_refused(text):
    with pytest.raises(InputError, match="udpout:HOST:PORT"):
        parse_mavlink_address(text)


def test_without_a_vehicle_there_is_nothing_to_send():
    with pytest.raises(InputError, match="--vehicle"), mavlink_output("udpout:127.0.0.1:14550", None):
        pass
