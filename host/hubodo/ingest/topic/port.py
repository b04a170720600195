"""Ports that are ROS 2 topics: samples of a node, wheel speeds or fixes, by the name of the port."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from hubodo.errors import InputError
from hubodo.ingest.link.ports import PortName
from hubodo.ingest.link.topic_name import TOPIC_KIND
from hubodo.log import ros2
from hubodo.log.roles import TopicCandidate, TopicSelection, assign_roles, node_name_of_topic
from hubodo.vehicle import Vehicle

TopicRole = Literal["node", "wheels", "gnss"]

ROLE_TYPES: Mapping[TopicRole, tuple[str, ...]] = {
    "node": (ros2.IMU,),
    "wheels": (ros2.JOINT_STATE, ros2.TWIST_STAMPED, ros2.TWIST_WITH_COVARIANCE_STAMPED, ros2.ODOMETRY),
    "gnss": (ros2.NAV_SAT_FIX,),
}
"""Message types accepted in each role."""


@dataclass(frozen=True, slots=True)
class TopicPort:
    """A topic that is recorded.

    Attributes
    ----------
    label
        Name of the link; of a node also its name in the log.
    topic
        Name of the topic, from the root.
    role
        What its messages are.
    joints
        Names of the left and the right wheel joint; empty to recognise them by their names.
    """

    label: str
    topic: str
    role: TopicRole
    joints: tuple[str, ...] = ()


def parse_topic_port(port: PortName, *, is_gnss: bool = False) -> TopicPort:
    """Return the topic of a port `[NAME=]ros2:/topic`, for `wheels` with `:LEFT,RIGHT` joints.

    Raises InputError for joints that are not two.
    """
    assert port.kind == TOPIC_KIND
    topic, _, names = port.target.partition(":")
    role: TopicRole = "gnss" if is_gnss or port.name == "gnss" else "node"
    role = "wheels" if port.name == "wheels" else role
    joints = tuple(part for part in names.split(",") if part)
    if joints and (role != "wheels" or len(joints) != 2):
        raise InputError(f"port {port.text!r}: write wheels=ros2:{topic}:LEFT,RIGHT with two joints")
    label = port.name or ("gnss" if is_gnss else node_name_of_topic(topic))
    return TopicPort(label, topic, role, joints)


def match_vehicle_nodes(
    ports: Sequence[tuple[PortName, TopicPort]], vehicle: Vehicle | None
) -> list[TopicPort]:
    """Return the topics; those without a given name get the name of the vehicle's node that they match.

    The rules are those for logs of other programs: a topic is the node `left` if it alone contains that word.
    """
    nodes = {} if vehicle is None else vehicle.nodes
    unnamed = {topic.topic: topic for port, topic in ports if port.name is None and topic.role == "node"}
    named = {topic.label for port, topic in ports if port.name is not None}
    assignment = assign_roles(
        {topic: TopicCandidate(ros2.IMU) for topic in unnamed},
        TopicSelection(
            node_is_on_wheel={name: mount.side is not None for name, mount in nodes.items()},
            required_roles=frozenset(),
        ),
        is_hubodo=False,
        log_name="ros2",
    )
    names = {topic: name for name, topic in assignment.nodes.items() if name not in named}
    return [
        replace(topic, label=names.get(topic.topic, topic.label)) if port.name is None else topic
        for port, topic in ports
    ]
