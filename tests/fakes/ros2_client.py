"""A ROS 2 client of services in its own process, in the form of rmw_cyclonedds, with types written by hand.

    python tests/fakes/ros2_client.py DOMAIN

Calls /hubodo/set_pose and /hubodo/find_bias, sends one message on the topic /hubodo/reset, and prints the
replies as one JSON object. Each request and reply begins with the identifier of the client and the number
of the request.
"""

import json
import sys
import time
from dataclasses import dataclass

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsSubscription
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import int64, uint8, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from ros2_subscriber import (
    CONFIG,
    DEFAULT,
    Header,
    Pose,
    PoseWithCovariance,
    Position,
    Quaternion,
    Time,
    plain,
)

CLIENT = 0x0123456789ABCDEF
TIMEOUT_S = 300.0


@dataclass
class Empty(IdlStruct, typename="std_msgs::msg::dds_::Empty_"):
    structure_needs_at_least_one_member: uint8


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovarianceStamped_"):
    header: Header
    pose: PoseWithCovariance


@dataclass
class SetPoseRequest(IdlStruct, typename="robot_localization::srv::dds_::SetPose_Request_"):
    client_guid: uint64
    sequence_number: int64
    pose: PoseStamped


@dataclass
class SetPoseResponse(IdlStruct, typename="robot_localization::srv::dds_::SetPose_Response_"):
    client_guid: uint64
    sequence_number: int64
    structure_needs_at_least_one_member: uint8


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    client_guid: uint64
    sequence_number: int64
    structure_needs_at_least_one_member: uint8


@dataclass
class TriggerResponse(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    client_guid: uint64
    sequence_number: int64
    success: bool
    message: str


QOS = Qos(Policy.DataRepresentation(use_cdrv0_representation=True), base=DEFAULT)


def until(condition):
    """Wait for a condition; return its value."""
    end = time.monotonic() + TIMEOUT_S
    while not (value := condition()) and time.monotonic() < end:
        time.sleep(0.01)
    return value


def call(participant, service, request, response_type):
    """Call a service; return the replies received, those of other clients included."""
    requests = Topic(participant, f"rq{service}Request", type(request))
    replies = Topic(participant, f"rr{service}Reply", response_type)
    writer, reader = DataWriter(participant, requests, QOS), DataReader(participant, replies, QOS)
    # rclcpp calls a service once both endpoints of the server are matched.
    until(lambda: writer.get_matched_subscriptions() and reader.get_matched_publications())
    writer.write(request)
    return [plain(reply) for reply in until(lambda: reader.take(N=10))]


def main():
    domain = int(sys.argv[1])
    held = Domain(domain, CONFIG)
    participant = DomainParticipant(domain)
    pose = Pose(Position(3.0, -2.0, 0.0), Quaternion(0.0, 0.0, 0.6, 0.8))
    covariance = [float(n) for n in range(36)]
    stamped = PoseStamped(Header(Time(0, 0), "odom"), PoseWithCovariance(pose, covariance))
    replies = {
        "set_pose": call(
            participant, "/hubodo/set_pose", SetPoseRequest(CLIENT, 7, stamped), SetPoseResponse
        ),
        "find_bias": call(participant, "/hubodo/find_bias", TriggerRequest(CLIENT, 8, 0), TriggerResponse),
    }
    writer = DataWriter(participant, Topic(participant, "rt/hubodo/reset", Empty), QOS)
    until(writer.get_matched_subscriptions)
    writer.write(Empty(0))
    subscriptions = BuiltinDataReader(participant, BuiltinTopicDcpsSubscription)
    user_data = {}
    for reader in subscriptions.take(N=100):
        data = reader.qos[Policy.Userdata]
        user_data[reader.topic_name] = "" if data is None else data.data.decode()
    time.sleep(0.2)
    del held
    print(json.dumps({"replies": replies, "user_data": user_data}))


if __name__ == "__main__":
    main()
