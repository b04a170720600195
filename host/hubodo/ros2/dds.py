"""A ROS 2 node over DDS, by Cyclone DDS: what rmw_cyclonedds and rmw_fastrtps send and expect.

Messages are encoded by the caller: the classes that Cyclone DDS needs for its types pass bytes through.
"""

from __future__ import annotations

import os
import threading
import time
import uuid
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, InstanceState, Listener, ReadCondition, SampleState, ViewState
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from hubodo.errors import InputError
from hubodo.log import ros2
from hubodo.ros2.cdr import decode_message, encode_message
from hubodo.ros2.config import Ros2Config
from hubodo.ros2.dds_types import REQUEST_ID, message_class
from hubodo.ros2.names import LATCHED, RELIABLE, QosProfile, dds_topic, message_type_of, service_topics
from hubodo.ros2.node import OnMessage, OnRequest
from hubodo.ros2.type_hash import service_hash, type_hash

_DISCOVERY_TOPIC = "ros_discovery_info"
_MAX_BLOCKING_MS = 5
"""Time for which a reliable writer may wait for a slow subscriber; then the message is dropped."""
_MAX_DISCOVERY_S = 0.3
_MAX_TAKE = 256
_MAX_PUBLICATIONS = 10_000
_TOPIC_PREFIX = dds_topic("")
# The node announces itself to the ports of this computer only. Without multicast other computers neither
# discover the node nor can send to it. It uses the loopback interface, because Fast DDS answers nodes of the
# same computer there, whatever their address.
_LOCALHOST = """<General>
<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><SPDPInterval>1s</SPDPInterval>
<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>100</MaxAutoParticipantIndex>
<Peers><Peer Address="localhost"/></Peers></Discovery>"""
# WriterLingerDuration: a subscriber that hangs delays the end of each reliable publisher by this time, by
# default one second.
_SETTINGS = """<CycloneDDS><Domain Id="any">%s
<Internal><WriterLingerDuration>100ms</WriterLingerDuration></Internal></Domain></CycloneDDS>"""


class DdsPublisher:
    """A publisher of one topic; `dropped` counts messages that a slow subscriber did not take in time."""

    def __init__(self, writer: Any, message_class: Any) -> None:
        self.dropped = 0
        self._writer, self._message = writer, object.__new__(message_class)

    def publish(self, payload: bytes) -> None:
        """Send one message."""
        self._message.payload = payload
        try:
            self._writer.write(self._message)
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise
            self.dropped += 1

    def await_subscriber(self) -> None:
        """Wait a moment for a subscriber; a client may send its request before its reader is discovered."""
        end = time.monotonic() + _MAX_DISCOVERY_S
        while not self._writer.get_matched_subscriptions() and time.monotonic() < end:
            time.sleep(0.01)


class _MessageListener(Listener):  # type: ignore[misc]
    """Passes the messages of a reader on."""

    def __init__(self, on_message: OnMessage) -> None:
        super().__init__()
        self._on_message = on_message

    def on_data_available(self, reader: Any) -> None:
        """Take all messages."""
        while samples := reader.take(N=_MAX_TAKE):
            for sample in samples:
                payload = getattr(sample, "payload", None)
                if payload is not None:  # absent when a writer ends
                    self._on_message(payload)


class DdsNode:
    """A participant that ROS 2 lists as a node."""

    def __init__(self, config: Ros2Config) -> None:
        """Join the domain; raise InputError if that is not possible."""
        assert config.domain is not None
        self._config = config
        self._graph_type = ros2.HUMBLE_PARTICIPANT_ENTITIES if config.is_humble else ros2.PARTICIPANT_ENTITIES
        self._lock = threading.Lock()
        self._entities: list[Any] = []
        self._writer_ids: list[bytes] = []
        self._reader_ids: list[bytes] = []
        settings = _SETTINGS % (_LOCALHOST if config.network == "localhost" else "")
        has_own_settings = "CYCLONEDDS_URI" in os.environ
        try:
            self._domain = Domain(config.domain, None if has_own_settings else settings)
            self._participant = DomainParticipant(config.domain, Qos(Policy.Userdata(b"enclave=/;")))
            self._publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
            self._present = ReadCondition(
                self._publications, ViewState.Any | SampleState.Any | InstanceState.Alive
            )
            self._graph = self._create_writer(
                _DISCOVERY_TOPIC, message_class(self._graph_type), _make_qos(LATCHED, self._graph_type)
            )
            self._announce()
        except DDSException as error:
            raise InputError(f"ROS domain {config.domain}: {error}") from None

    def create_publisher(self, topic: str, message_type: str, qos: QosProfile) -> DdsPublisher:
        """Return a publisher of a topic; see `Node`."""
        with self._lock:
            publisher = self._create_writer(
                dds_topic(topic), message_class(message_type), _make_qos(qos, message_type)
            )
            self._writer_ids.append(self._entities[-1].guid.bytes)
            self._announce()
        return publisher

    def subscribe(self, topic: str, message_type: str, qos: QosProfile, on_message: OnMessage) -> None:
        """Pass on the messages of a topic; see `Node`."""
        self._create_reader(
            dds_topic(topic), message_class(message_type), _make_qos(qos, message_type), on_message
        )
        with self._lock:
            self._announce()

    def serve(self, service: str, service_type: str, on_request: OnRequest) -> None:
        """Serve a service in the way of rmw_cyclonedds; see `Node`.

        Clients with Fast DDS put the identifier of a request into the header of its DDS sample, which
        Cyclone DDS can neither read nor write: their requests are carried out, but not answered.
        """
        request_topic, reply_topic = service_topics(service)
        request_class, reply_class = (
            message_class(f"{service_type}_{part}", is_service=True) for part in ("Request", "Response")
        )
        identifier = ".".join(f"{byte:x}" for byte in uuid.uuid4().bytes)
        user_data = f"serviceid={identifier};typehash={service_hash(service_type)};"
        qos = _qos_policies(RELIABLE, user_data)
        with self._lock:
            replies = self._create_writer(reply_topic, reply_class, qos)
            self._writer_ids.append(self._entities[-1].guid.bytes)

        def receive(payload: bytes) -> None:
            request_id = payload[REQUEST_ID]
            request = payload[: REQUEST_ID.start] + payload[REQUEST_ID.stop :]
            try:
                decode_message(f"{service_type}_Request", request)
            except ValueError:
                on_request(payload, lambda _: None)  # without an identifier
                return

            def reply(response: bytes) -> None:
                replies.await_subscriber()
                replies.publish(response[: REQUEST_ID.start] + request_id + response[REQUEST_ID.start :])

            on_request(request, reply)

        self._create_reader(request_topic, request_class, qos, receive)
        with self._lock:
            self._announce()

    def published_types(self) -> dict[str, frozenset[str]]:
        """Return the types published by other participants; see `Node`."""
        types: dict[str, frozenset[str]] = {}
        with self._lock:
            publications = self._publications.read(_MAX_PUBLICATIONS, self._present)
        for publication in publications:
            message_type = message_type_of(publication.type_name)
            is_own = publication.participant_key == self._participant.guid
            if is_own or message_type is None or not publication.topic_name.startswith(_TOPIC_PREFIX):
                continue
            topic = publication.topic_name.removeprefix(_TOPIC_PREFIX)
            types[topic] = types.get(topic, frozenset()) | {message_type}
        return types

    def close(self) -> None:
        """Leave the domain."""
        self._entities.clear()
        del self._present, self._publications, self._graph, self._participant, self._domain

    def _create_writer(self, name: str, sent_class: Any, qos: Any) -> DdsPublisher:
        topic = Topic(self._participant, name, sent_class)
        writer = DataWriter(self._participant, topic, qos)
        self._entities += [topic, writer]
        return DdsPublisher(writer, sent_class)

    def _create_reader(self, name: str, received_class: Any, qos: Any, on_message: OnMessage) -> None:
        topic = Topic(self._participant, name, received_class)
        listener = _MessageListener(on_message)
        # What this process publishes is not received by itself.
        reader = DataReader(self._participant, topic, Qos(Policy.IgnoreLocal.Process, base=qos), listener)
        with self._lock:
            self._entities += [topic, listener, reader]
            self._reader_ids.append(reader.guid.bytes)

    def _announce(self) -> None:
        """Publish which readers and writers belong to the node, for `ros2 node list` and `node info`."""
        node = {
            "node_namespace": "/",
            "node_name": self._config.node,
            "reader_gid_seq": [self._gid(guid) for guid in self._reader_ids],
            "writer_gid_seq": [self._gid(guid) for guid in self._writer_ids],
        }
        values = {"gid": self._gid(self._participant.guid.bytes), "node_entities_info_seq": [node]}
        self._graph.publish(encode_message(self._graph_type, values))

    def _gid(self, guid: bytes) -> dict[str, list[int]]:
        return {"data": list(guid.ljust(24 if self._config.is_humble else 16, b"\0"))}


def _make_qos(qos: QosProfile, message_type: str) -> Any:
    """Return the policies of a reader or writer of a message type."""
    return _qos_policies(qos, f"typehash={type_hash(message_type)};")


def _qos_policies(qos: QosProfile, user_data: str) -> Any:
    """Return policies with the user data of an endpoint; ROS 2 uses the first version of the encoding."""
    reliable = Policy.Reliability.Reliable(duration(milliseconds=_MAX_BLOCKING_MS))
    return Qos(
        reliable if qos.is_reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if qos.is_transient_local else Policy.Durability.Volatile,
        Policy.History.KeepLast(qos.depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(user_data.encode()),
    )
