"""A topic with losses, wrong stamps, reordered, damaged and unusable messages: counted, never raised."""

import sys
from pathlib import Path

import numpy as np
import pytest

import wanted
from hubodo.ingest.link.link import LinkLost, LinkUp, TopicMessage
from hubodo.ingest.node.log_times import LogTimeSequence
from hubodo.ingest.topic.handlers import FixHandler, ImuHandler, create_handler
from hubodo.ingest.topic.port import TopicPort
from hubodo.ingest.topic.session import TopicSession
from hubodo.log import ros2
from hubodo.log.records import Columns, EventRecord, GnssFix, ImuBlock, ImuNoise
from hubodo.vehicle import load_vehicle
from vehicles import vehicle_toml

wanted.module("cyclonedds")
sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "fakes"))
from ros2_publisher import build  # noqa: E402

START_NS = 1_790_000_000_000_000_000
PERIOD_NS = 5_000_000


class Records(list):
    write_record = list.append

    def of(self, kind):
        return [record for record in self if isinstance(record, kind)]

    def events(self, kind):
        return [record.event for record in self.of(EventRecord) if record.event.kind == kind]


def imu_session():
    sink = Records()
    port = TopicPort("left", "/left/imu", "node")
    session = TopicSession(port, ImuHandler("left", sink, LogTimeSequence()), sink)
    session.connection.handle_up(LinkUp("left", START_NS, "ros2:/left/imu", False))
    return session, sink


def message(number, kind="imu", message_type=ros2.IMU, stamp=0.0, payload=None, **values):
    t_ns = START_NS + number * PERIOD_NS
    given = {"gyro": [number, 0.5, -1.0], "accel": [0.0, 0.0, 9.8], "stamp": stamp, **values}
    data = build(kind, given, t_ns).serialize(use_version_2=False) if payload is None else payload
    return TopicMessage("left", t_ns + 1_000_000, 0, message_type, data)


def test_samples_are_logged_with_their_stamps_and_the_noise_that_is_stated():
    session, sink = imu_session()
    for number in range(100):
        (block,) = session.handle_message(message(number, variances=[4e-4, 0.01]))
        assert block.t_ns.tolist() == [START_NS + number * PERIOD_NS]
        assert block.gyro.tolist() == [[number, 0.5, -1.0]]
    assert sink.of(ImuNoise) == [ImuNoise("left", 0.02, 0.1)]
    assert np.all(np.diff([block.t_log_ns for block in sink.of(ImuBlock)]) > 0)
    assert session.mean_rate() == pytest.approx(200.0)
    assert not session.damage and not session.gaps


def test_every_kind_of_damage_is_counted_and_the_other_samples_are_used():
    session, sink = imu_session()
    numbers = [n for n in range(200) if n not in (75, 76, 150)]
    for number in numbers:
        session.handle_message(message(number))
        if number == 80:
            session.handle_message(message(70))  # late
            session.handle_message(message(80))  # sent twice
        if number == 90:
            session.handle_message(message(90, stamp=-500.0))
            session.handle_message(message(90, gyro=[float("nan"), 0.0, 0.0]))
            session.handle_message(message(90, payload=b"\x00\x01\x00\x00\x07"))
            session.handle_message(message(90, payload=b""))
    # A NaN sample has a stamp that was seen already: it is counted once.
    assert dict(session.damage) == {"out of order": 3, "wrong stamp": 1, "undecodable": 2}
    assert [block.gyro[0, 0] for block in sink.of(ImuBlock)] == numbers
    assert dict(session.gaps) == {"lost on the way": 2}
    assert [event.data["samples_lost"] for event in sink.events("gap")] == [2, 1]
    assert session.samples_lost == 3
    (event,) = list(session.tick(START_NS))
    assert "out of order 3" in event.text and "/left/imu" in event.text
    assert list(session.tick(START_NS + 1)) == []


def test_a_sample_that_is_not_finite_is_left_out():
    session, sink = imu_session()
    for number in range(50):
        session.handle_message(message(number, accel=[0.0, float("inf") if number == 20 else 0.0, 9.8]))
    assert dict(session.damage) == {"unusable": 1}
    assert len(sink.of(ImuBlock)) == 49


def test_a_publisher_that_vanishes_leaves_a_gap_with_the_cause():
    session, sink = imu_session()
    for number in range(100):
        session.handle_message(message(number))
    session.connection.handle_lost(LinkLost("left", START_NS, "nobody publishes it"))
    session.connection.handle_up(LinkUp("left", START_NS, "ros2:/left/imu", False))
    for number in range(900, 1000):
        session.handle_message(message(number))
    (gap,) = sink.events("gap")
    assert gap.data["cause"] == "link down" and gap.data["samples_lost"] is None
    assert gap.data["duration_s"] == pytest.approx(801 * PERIOD_NS * 1e-9)
    assert len(sink.events("disconnected")) == 1 and session.samples == 200


def test_fixes_are_logged_with_their_sigma_and_refused_outside_the_earth():
    sink = Records()
    session = TopicSession(TopicPort("gnss", "/fix", "gnss"), FixHandler(sink, LogTimeSequence()), sink)
    items = []
    for number, latitude, status in ((0, 47.4, 0), (1, 95.0, 0), (2, 47.5, -1), (3, 47.6, 2)):
        values = {"latitude": latitude, "longitude": 8.5, "altitude": 400.0, "sigma": 2.0, "status": status}
        items += session.handle_message(message(number, "fix", ros2.NAV_SAT_FIX, **values))
    assert [(fix.latitude_deg, fix.sigma) for fix in items] == [(47.4, 2.0), (47.6, 2.0)]
    assert [fix.sigma for fix in sink.of(GnssFix)] == [(2.0, 2.0, 2.0)] * 3
    assert dict(session.damage) == {"unusable": 1}


@pytest.mark.parametrize(
    ("joints", "kind", "message_type", "values"),
    [
        (
            (),
            "joints",
            ros2.JOINT_STATE,
            {"names": ["r_wheel", "arm", "l_wheel"], "velocity": [12.0, 9.0, 8.0]},
        ),
        (("a", "b"), "joints", ros2.JOINT_STATE, {"names": ["a", "b"], "velocity": [8.0, 12.0]}),
        ((), "twist", ros2.TWIST_STAMPED, {"speed": 1.5, "yaw_rate": 1.2}),
    ],
)
def test_encoders_become_surface_speeds(tmp_path, joints, kind, message_type, values):
    # Radius 0.15 m: 8 and 12 rad/s are 1.2 and 1.8 m/s; 1.5 m/s and 1.2 rad/s at a track width of 0.5 m too.
    (tmp_path / "v.toml").write_text(vehicle_toml(0.15, 0.5))
    sink = Records()
    port = TopicPort("wheels", "/joints", "wheels", joints)
    handler = create_handler(port, sink, LogTimeSequence(), load_vehicle(tmp_path / "v.toml"))
    session = TopicSession(port, handler, sink)
    session.handle_message(message(0, kind, message_type, **values))
    session.handle_message(message(1, "joints", ros2.JOINT_STATE, names=["arm"], velocity=[1.0]))
    (row,) = sink.of(Columns)
    assert row.name == "wheels" and row.t_ns == [START_NS]
    assert row.columns["left"] == pytest.approx([1.2]) and row.columns["right"] == pytest.approx([1.8])
    assert dict(session.damage) == {"unusable": 1}
