"""The interface of a ROS 2 node with publishers, subscribers and services of encoded messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from hubodo.ros2.names import QosProfile

OnMessage = Callable[[bytes], None]
"""Called with each message as CDR, in a thread of the transport; must return at once."""


Reply = Callable[[bytes], None]
"""Sends the response to one request, CDR with encapsulation; from any thread."""
OnRequest = Callable[[bytes, Reply], None]
"""Called with each request as CDR and its reply, in a thread of the transport; must return at once."""


class Publisher(Protocol):
    """A publisher of one topic."""

    def publish(self, payload: bytes) -> None:
        """Send one message, CDR with encapsulation."""
        ...


class Node(Protocol):
    """A node of the ROS 2 graph."""

    def create_publisher(self, topic: str, message_type: str, qos: QosProfile) -> Publisher:
        """Return a publisher of a topic; the node lists it in the graph."""
        ...

    def subscribe(self, topic: str, message_type: str, qos: QosProfile, on_message: OnMessage) -> None:
        """Call `on_message` with each message of a topic until the node is closed."""
        ...

    def serve(self, service: str, service_type: str, on_request: OnRequest) -> None:
        """Call `on_request` with each request of a service until the node is closed."""
        ...

    def published_types(self) -> dict[str, frozenset[str]]:
        """Return the message types that other nodes publish at present, by topic."""
        ...

    def close(self) -> None:
        """Leave the graph."""
        ...
