"""Names of ROS 2 topics and types on the wire, and the quality of service of each topic."""

from __future__ import annotations

from dataclasses import dataclass

from hubodo.log import ros2, topics


@dataclass(frozen=True, slots=True)
class QosProfile:
    """Quality of service; depth: number of messages that a queue holds."""

    is_reliable: bool
    is_transient_local: bool
    depth: int


SENSOR_DATA = QosProfile(is_reliable=False, is_transient_local=False, depth=5)
"""`rmw_qos_profile_sensor_data`: lost messages are not repeated."""
RELIABLE = QosProfile(is_reliable=True, is_transient_local=False, depth=10)
"""`rmw_qos_profile_default`, which subscribers of either kind of reliability accept."""
MOTION = QosProfile(is_reliable=True, is_transient_local=False, depth=100)
"""Odometry and frames, as `tf2_ros` publishes them: a subscriber may fall a quarter of a second behind."""
LATCHED = QosProfile(is_reliable=True, is_transient_local=True, depth=1)
"""For /tf_static: a subscriber that joins later receives the last message."""

_SENSOR_TYPES = frozenset(
    {ros2.IMU, ros2.MAGNETIC_FIELD, ros2.TEMPERATURE, ros2.BATTERY, ros2.NAV_SAT_FIX, ros2.JOINT_STATE}
    | {ros2.TWIST_STAMPED}
)
PUBLISHED_TYPES = frozenset(
    {ros2.IMU, ros2.MAGNETIC_FIELD, ros2.TEMPERATURE, ros2.BATTERY, ros2.NAV_SAT_FIX}
    | {ros2.ODOMETRY, ros2.TF, ros2.DIAGNOSTICS}
)
"""Message types of the log that a live node publishes."""


def topic_qos(topic: str, message_type: str) -> QosProfile:
    """Return the quality of service that ROS 2 expects of a topic."""
    if topic == topics.TF_STATIC:
        return LATCHED
    if message_type in (ros2.ODOMETRY, ros2.TF):
        return MOTION
    return SENSOR_DATA if message_type in _SENSOR_TYPES else RELIABLE


def dds_topic(topic: str) -> str:
    """Return the DDS name of a topic: `rt/odom` for /odom."""
    return f"rt{topic}"


def service_topics(service: str) -> tuple[str, str]:
    """Return the DDS names of the topics for requests and replies of a service."""
    return f"rq{service}Request", f"rr{service}Reply"


def dds_type(message_type: str) -> str:
    """Return the DDS name of a type: `nav_msgs::msg::dds_::Odometry_` for nav_msgs/msg/Odometry."""
    package, kind, name = full_name(message_type).split("/")
    return f"{package}::{kind}::dds_::{name}_"


def message_type_of(dds_name: str) -> str | None:
    """Return the message type of a DDS type, the inverse of `dds_type`; None for other types."""
    package, kind, name = [*dds_name.partition("::msg::dds_::")]
    return f"{package}/msg/{name.removesuffix('_')}" if kind and name.endswith("_") else None


def full_name(message_type: str) -> str:
    """Return a type with its interface kind, as `std_msgs/msg/Header` for std_msgs/Header."""
    kind = "srv" if "/srv/" in message_type else "msg"
    return f"{package_of(message_type)}/{kind}/{base_name(message_type)}"


def package_of(message_type: str) -> str:
    """Return the package of a type."""
    return message_type.partition("/")[0]


def base_name(message_type: str) -> str:
    """Return the name of a type without its package."""
    return message_type.rpartition("/")[2]
