"""A ROS 2 node over Zenoh, with the keys and liveliness tokens of rmw_zenoh (docs/design.md there)."""

from __future__ import annotations

import struct
import threading
import time
import uuid
from typing import Any

import zenoh

from hubodo.errors import InputError
from hubodo.ros2.config import Ros2Config
from hubodo.ros2.names import RELIABLE, QosProfile, dds_type, message_type_of
from hubodo.ros2.node import OnMessage, OnRequest
from hubodo.ros2.type_hash import service_hash, type_hash
from hubodo.safe_text import json_text

_ADMIN_SPACE = "@ros2_lv"
_NODE_ID = 0
_ROOT_NAMESPACE = "%"
"""Enclave and namespace "/"; a slash within a part of a token is written as %."""
_ATTACHMENT = struct.Struct("<qqB16s")
"""Sequence number, source time in ns, length and bytes of the publisher's identifier."""


class ZenohPublisher:
    """A publisher of one topic."""

    def __init__(self, publisher: Any, gid: bytes) -> None:
        self._publisher, self._gid, self._sequence = publisher, gid, 0

    def publish(self, payload: bytes) -> None:
        """Send one message."""
        self._sequence += 1
        attachment = _ATTACHMENT.pack(self._sequence, time.time_ns(), len(self._gid), self._gid)
        self._publisher.put(payload, attachment=attachment)


class ZenohNode:
    """A Zenoh session that ROS 2 lists as a node."""

    def __init__(self, config: Ros2Config) -> None:
        """Open a session; a router that is not running yet is awaited in the background."""
        self._config = config
        self._lock = threading.Lock()
        self._entities: list[Any] = []
        self._next_id = _NODE_ID + 1
        try:
            self._session = zenoh.open(_session_config(config))
        except zenoh.ZError as error:
            raise InputError(f"Zenoh router {config.router}: {error}") from None
        self._declare_token("NN", _NODE_ID, "")
        self._publications: dict[str, tuple[str, str]] = {}
        watched = f"{_ADMIN_SPACE}/{config.domain}/*/*/*/MP/**"
        self._entities.append(
            self._session.liveliness().declare_subscriber(watched, self._note_publication, history=True)
        )

    def create_publisher(self, topic: str, message_type: str, qos: QosProfile) -> ZenohPublisher:
        """Return a publisher of a topic; see `Node`."""
        key = self._key(topic, message_type)
        reliability = zenoh.Reliability.RELIABLE if qos.is_reliable else zenoh.Reliability.BEST_EFFORT
        # A slow subscriber loses messages; it never delays the publisher.
        options = {"reliability": reliability, "congestion_control": zenoh.CongestionControl.DROP}
        if qos.is_transient_local:
            publisher: Any = zenoh.ext.declare_advanced_publisher(
                self._session,
                key,
                cache=zenoh.ext.CacheConfig(max_samples=qos.depth),
                publisher_detection=True,
                congestion_control=zenoh.CongestionControl.DROP,
            )
        else:
            publisher = self._session.declare_publisher(key, **options)
        with self._lock:
            self._entities.append(publisher)
            self._announce("MP", topic, message_type, type_hash(message_type), qos)
        return ZenohPublisher(publisher, uuid.uuid4().bytes)

    def subscribe(self, topic: str, message_type: str, qos: QosProfile, on_message: OnMessage) -> None:
        """Pass on the messages of a topic, of any version of their type; see `Node`."""
        key = f"{self._config.domain}/{topic.strip('/')}/{dds_type(message_type)}/*"
        subscriber = self._session.declare_subscriber(
            key,
            lambda sample: on_message(sample.payload.to_bytes()),
            # What this process publishes is not received by itself.
            allowed_origin=zenoh.Locality.REMOTE,
        )
        with self._lock:
            self._entities.append(subscriber)
            self._announce("MS", topic, message_type, type_hash(message_type), qos)

    def serve(self, service: str, service_type: str, on_request: OnRequest) -> None:
        """Serve a service by a queryable; see `Node`."""
        hash_of_type = service_hash(service_type)
        key = f"{self._config.domain}/{service.strip('/')}/{dds_type(service_type)}/{hash_of_type}"

        def receive(query: Any) -> None:
            attached = b"" if query.attachment is None else query.attachment.to_bytes()
            if len(attached) != _ATTACHMENT.size or query.payload is None:
                return  # not from a ROS 2 client
            sequence, _, *client = _ATTACHMENT.unpack(attached)

            def reply(response: bytes) -> None:
                attachment = _ATTACHMENT.pack(sequence, time.time_ns(), *client)
                query.reply(key, response, attachment=attachment)
                query.drop()

            on_request(query.payload.to_bytes(), reply)

        queryable = self._session.declare_queryable(key, receive, complete=True)
        with self._lock:
            self._entities.append(queryable)
            self._announce("SS", service, service_type, hash_of_type, RELIABLE)

    def published_types(self) -> dict[str, frozenset[str]]:
        """Return the types published by other sessions; see `Node`."""
        types: dict[str, frozenset[str]] = {}
        for topic, message_type in list(self._publications.values()):
            types[topic] = types.get(topic, frozenset()) | {message_type}
        return types

    def _note_publication(self, token: Any) -> None:
        """Note that a publisher of another session has appeared or gone, by its liveliness token."""
        key = str(token.key_expr)
        if token.kind == zenoh.SampleKind.DELETE:
            self._publications.pop(key, None)
            return
        session, *_, topic, dds_name, _, _ = key.removeprefix(f"{_ADMIN_SPACE}/").split("/")[1:]
        message_type = message_type_of(dds_name)
        if message_type is not None and session != str(self._session.info.zid()):
            self._publications[key] = topic.replace(_ROOT_NAMESPACE, "/"), message_type

    def close(self) -> None:
        """Close the session, which withdraws all tokens."""
        self._entities.clear()
        self._session.close()

    def _key(self, topic: str, message_type: str) -> str:
        return f"{self._config.domain}/{topic.strip('/')}/{dds_type(message_type)}/{type_hash(message_type)}"

    def _announce(self, kind: str, topic: str, message_type: str, hash_of_type: str, qos: QosProfile) -> None:
        name = topic.replace("/", _ROOT_NAMESPACE)
        detail = f"/{name}/{dds_type(message_type)}/{hash_of_type}/{format_qos(qos)}"
        self._declare_token(kind, self._next_id, detail)
        self._next_id += 1

    def _declare_token(self, kind: str, number: int, detail: str) -> None:
        session = self._session.info.zid()
        head = f"{_ADMIN_SPACE}/{self._config.domain}/{session}/{_NODE_ID}/{number}/{kind}"
        token = f"{head}/{_ROOT_NAMESPACE}/{_ROOT_NAMESPACE}/{self._config.node}{detail}"
        self._entities.append(self._session.liveliness().declare_token(token))


def format_qos(qos: QosProfile) -> str:
    """Return the quality of service as in a token: numbers of rmw, nothing where it is the default of rmw.

    Reliability (1 reliable, 2 best effort), durability (1 transient local, 2 volatile), history (1 keep
    last) with its depth, then deadline, lifespan and liveliness.
    """
    reliability = "" if qos.is_reliable else "2"
    durability = "1" if qos.is_transient_local else ""
    return f"{reliability}:{durability}:,{qos.depth}:,:,:,,"


def _session_config(config: Ros2Config) -> Any:
    """Return the settings of a session of rmw_zenoh: a peer that learns of others from the router."""
    settings = zenoh.Config()
    values: dict[str, Any] = {
        "mode": "peer",
        "connect/endpoints": [config.router],
        "connect/exit_on_failure": False,
        "connect/timeout_ms": 0,
        "scouting/multicast/enabled": False,
        "listen/endpoints": ["tcp/localhost:0" if config.network == "localhost" else "tcp/0.0.0.0:0"],
        "timestamping/enabled": True,
    }
    for key, value in values.items():
        settings.insert_json5(key, json_text(value))
    return settings
