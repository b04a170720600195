"""The links of a recording, from its settings: ports of nodes, of a GNSS receiver, and ROS 2 topics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hubodo.errors import InputError, LinkError
from hubodo.ingest.link.ports import DeviceLister, PortName, attach_keys, parse_port
from hubodo.ingest.link.topic_name import TOPIC_KIND, is_topic
from hubodo.ingest.live.computer import Computer, Link
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.node.naming import unique_name
from hubodo.ingest.topic.link import TopicLink
from hubodo.ingest.topic.port import TopicPort, match_vehicle_nodes, parse_topic_port
from hubodo.ros2.config import Ros2Config
from hubodo.vehicle import Vehicle


@dataclass(frozen=True)
class RecordLinks:
    """The links of a recording by label.

    Attributes
    ----------
    links
        All links, not opened.
    names
        Node name by link label, None to derive it from the node id.
    nmea
        Labels of links of GNSS receivers.
    topics
        Ports that are ROS 2 topics.
    """

    links: dict[str, Link] = field(default_factory=dict)
    names: dict[str, str | None] = field(default_factory=dict)
    nmea: list[str] = field(default_factory=list)
    topics: list[TopicPort] = field(default_factory=list)

    @property
    def has_gnss(self) -> bool:
        """True if fixes may be received."""
        return bool(self.nmea) or any(topic.role == "gnss" for topic in self.topics)

    @property
    def received_topics(self) -> frozenset[str]:
        """Labels of the ports that are ROS 2 topics."""
        return frozenset(topic.label for topic in self.topics)


def create_links(
    config: RecordConfig,
    computer: Computer,
    lister: DeviceLister,
    vehicle: Vehicle | None,
    ros2: Ros2Config | None,
) -> RecordLinks:
    """Return the links of all ports; raise InputError for a port that is invalid or given twice.

    ros2: completed settings, required for topics.
    """
    created = RecordLinks(topics=_parse_topic_ports(config, vehicle))
    links = created.links
    for topic in created.topics:
        if ros2 is None:
            raise InputError(f"port ros2:{topic.topic}: the settings of ROS 2 are missing")
        links[topic.label] = TopicLink(topic, computer, computer.now_ns, computer.wall_ns, ros2)
    wanted = [(text, config.baud, False) for text in config.ports]
    wanted += [(config.gnss, config.gnss_baud, True)] if config.gnss is not None else []
    used_ports: set[tuple[str, str]] = set()
    for text, baud, is_gnss in wanted:
        port = attach_keys(parse_port(text), config.key_path, insecure=config.insecure_kinds)
        if (port.kind, port.target) in used_ports:
            raise InputError(f"port {text!r}: given twice; give each port once")
        used_ports.add((port.kind, port.target))
        if port.kind == TOPIC_KIND:
            continue
        label = "gnss" if is_gnss else unique_name(port.label, {*links, "gnss"})
        links[label] = computer.create_link(port, label, baud, lister)
        if is_gnss:
            created.nmea.append(label)
        else:
            created.names[label] = port.name
    return created


def open_links(links: Mapping[str, Link]) -> None:
    """Open all links; raise InputError for one that cannot be opened."""
    for link in links.values():
        try:
            link.open_now()
        except LinkError as error:
            raise InputError(f"{error} (or use --wait)") from None


def _parse_topic_ports(config: RecordConfig, vehicle: Vehicle | None) -> list[TopicPort]:
    """Return the ports that are ROS 2 topics; raise InputError if two have the same name."""
    ports: list[tuple[PortName, TopicPort]] = []
    for text in config.topic_ports():
        port = parse_port(text)
        ports.append((port, parse_topic_port(port, is_gnss=text == config.gnss)))
    topics = match_vehicle_nodes(ports, vehicle)
    others = [] if config.gnss is None or is_topic(config.gnss) else ["gnss"]
    labels = [*others, *(topic.label for topic in topics)]
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(f"ports: two are named {label!r}; give them names, as in left=ros2:/TOPIC")
    if vehicle is None and any(topic.role == "wheels" for topic in topics):
        raise InputError("port wheels: the speed of the wheels follows from their radius; give --vehicle")
    return topics
