"""ROS 2 publishers in their own process: types written by hand from the ROS IDL, not from our definitions.

    python tests/fakes/ros2_publisher.py DOMAIN PLAN.json

The plan is a list of `[delay, topic, kind, values]`: a message is sent `delay` seconds after every topic has
a subscriber, with that time as its stamp, plus `stamp` of the values, or with `stamp_s`. The kind is imu
(gyro, accel, variances), joints (names, velocity), twist (speed, yaw_rate), fix (latitude, longitude, sigma),
or gone: the writer of the topic ends.
"""

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int8, sequence, uint8, uint16
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from ros2_subscriber import CONFIG, Header, Imu, Quaternion, Time, Twist, Vector3


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TwistStamped_"):
    header: Header
    twist: Twist


@dataclass
class NavSatStatus(IdlStruct, typename="sensor_msgs::msg::dds_::NavSatStatus_"):
    status: int8
    service: uint16


@dataclass
class NavSatFix(IdlStruct, typename="sensor_msgs::msg::dds_::NavSatFix_"):
    header: Header
    status: NavSatStatus
    latitude: float64
    longitude: float64
    altitude: float64
    position_covariance: array[float64, 9]
    position_covariance_type: uint8


QOS = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5), Policy.DataRepresentation(True, False))
TYPES = {"imu": Imu, "joints": JointState, "twist": TwistStamped, "fix": NavSatFix}


def diagonal(variance):
    return [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]


def build(kind, values, planned_ns):
    stamp_ns = planned_ns + round(1e9 * values.get("stamp", 0.0))
    stamp_ns = round(1e9 * values["stamp_s"]) if "stamp_s" in values else stamp_ns
    header = Header(Time(stamp_ns // 10**9, stamp_ns % 10**9), "sensor")
    if kind == "imu":
        gyro_variance, accel_variance = values.get("variances", (0.0, 0.0))
        return Imu(
            header,
            Quaternion(0.0, 0.0, 0.0, 1.0),
            [-1.0, *[0.0] * 8],
            Vector3(*values["gyro"]),
            diagonal(gyro_variance),
            Vector3(*values["accel"]),
            diagonal(accel_variance),
        )
    if kind == "joints":
        return JointState(header, values["names"], [], values["velocity"], [])
    if kind == "twist":
        linear, angular = Vector3(values["speed"], 0.0, 0.0), Vector3(0.0, 0.0, values["yaw_rate"])
        return TwistStamped(header, Twist(linear, angular))
    position = values["latitude"], values["longitude"], values.get("altitude", 0.0)
    covariance = diagonal(values["sigma"] ** 2)
    return NavSatFix(header, NavSatStatus(values.get("status", 0), 1), *position, covariance, 2)


def main():
    domain, plan = int(sys.argv[1]), json.loads(Path(sys.argv[2]).read_text())
    held = Domain(domain, CONFIG)
    participant = DomainParticipant(domain)
    writers = {}
    for _, topic, kind, _ in plan:
        if kind in TYPES and topic not in writers:
            described = Topic(participant, f"rt{topic}", TYPES[kind])
            writers[topic] = DataWriter(participant, described, QOS)
    print("ready", flush=True)
    while not all(writer.get_matched_subscriptions() for writer in writers.values()):
        time.sleep(0.01)
    start, start_ns = time.monotonic(), time.time_ns()
    for delay, topic, kind, values in plan:
        time.sleep(max(start + delay - time.monotonic(), 0.0))
        if kind == "gone":
            del writers[topic]
        else:
            writers[topic].write(build(kind, values, start_ns + round(1e9 * delay)))
    time.sleep(0.3)
    del held


if __name__ == "__main__":
    main()
