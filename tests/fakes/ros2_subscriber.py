"""A ROS 2 subscriber in its own process: types written by hand from the ROS IDL, not from our definitions.

    python tests/fakes/ros2_subscriber.py DOMAIN

Prints `received` once it has received `EXPECTED`, and, after a line on the standard input, all that it
received as one JSON object. The participant uses the loopback interface, as rmw_cyclonedds does with
ROS_LOCALHOST_ONLY=1, and the quality of service of robot_localization and tf2.
"""

import json
import sys
import threading
import time
from dataclasses import dataclass

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

CONFIG = """<CycloneDDS><Domain Id="any"><General><Interfaces>
<NetworkInterface address="127.0.0.1"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>100</MaxAutoParticipantIndex>
<Peers><Peer Address="localhost"/></Peers></Discovery></Domain></CycloneDDS>"""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Position(IdlStruct, typename="geometry_msgs::msg::dds_::Point_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Position
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Imu(IdlStruct, typename="sensor_msgs::msg::dds_::Imu_"):
    header: Header
    orientation: Quaternion
    orientation_covariance: array[float64, 9]
    angular_velocity: Vector3
    angular_velocity_covariance: array[float64, 9]
    linear_acceleration: Vector3
    linear_acceleration_covariance: array[float64, 9]


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: uint8
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: Header
    status: sequence[DiagnosticStatus]


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 16]


@dataclass
class NodeEntitiesInfo(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class ParticipantEntitiesInfo(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: sequence[NodeEntitiesInfo]


RELIABLE = Policy.Reliability.Reliable(duration(milliseconds=100))
SENSOR_DATA = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(50))
DEFAULT = Qos(RELIABLE, Policy.History.KeepLast(2000))
LATCHED = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(10))
TOPICS = {
    "rt/odom": (Odometry, DEFAULT),
    "rt/left/imu": (Imu, SENSOR_DATA),
    "rt/tf": (TFMessage, DEFAULT),
    "rt/tf_static": (TFMessage, LATCHED),
    "rt/diagnostics": (DiagnosticArray, DEFAULT),
    "ros_discovery_info": (ParticipantEntitiesInfo, LATCHED),
}


EXPECTED = {"rt/odom": 260, "rt/tf": 260, "rt/left/imu": 110, "rt/diagnostics": 3}
"""Number of messages by topic."""


def plain(value):
    """Return a message as dictionaries and lists."""
    if isinstance(value, IdlStruct):
        return {name: plain(getattr(value, name)) for name in value.__annotations__}
    return [plain(item) for item in value] if isinstance(value, list | tuple | bytes | bytearray) else value


def main():
    domain = int(sys.argv[1])
    ending = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), ending.set()), daemon=True).start()
    held = Domain(domain, CONFIG)
    participant = DomainParticipant(domain)
    readers = {
        name: DataReader(participant, Topic(participant, name, kind), qos)
        for name, (kind, qos) in TOPICS.items()
    }
    publications = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
    print("ready", flush=True)
    received = {name: [] for name in TOPICS}
    writers, is_reported = {}, False
    while not ending.is_set():
        if not is_reported and all(len(received[name]) >= count for name, count in EXPECTED.items()):
            is_reported = True
            print("received", flush=True)
        for name, reader in readers.items():
            now = time.time()
            received[name] += [
                [now, plain(sample)] for sample in reader.take(N=2000) if isinstance(sample, TOPICS[name][0])
            ]
        for writer in publications.take(N=100):
            key = getattr(writer, "topic_name", None)
            if key is not None and writer.participant_key != participant.guid:
                data = writer.qos[Policy.Userdata]
                writers[key] = [writer.type_name, "" if data is None else data.data.decode(), writer.key.hex]
        time.sleep(0.002)
    del held
    print(json.dumps({"received": received, "writers": writers}))


if __name__ == "__main__":
    main()
