"""The interface of transports: a ROS 2 node with publishers and subscribers of encoded messages."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from hubodo.extras import require_extra
from hubodo.ros2.config import Ros2Config, TransportName
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


def require_transport(transport: TransportName) -> None:
    """Raise InputError, with the command that installs it, if the package of a transport is missing."""
    module = {"dds": "cyclonedds", "zenoh": "zenoh"}[transport]
    require_extra("ros2", f"ROS 2 over {transport}", (module,))


def open_node(transport: TransportName, config: Ros2Config) -> Node:
    """Return a node that has joined the graph; config: completed by `complete_config`.

    Raises InputError if the package of the transport is missing or the network cannot be used.
    """
    require_transport(transport)
    if transport == "zenoh":
        from hubodo.ros2.zenoh import ZenohNode

        return ZenohNode(config)
    from hubodo.ros2.dds import DdsNode

    return DdsNode(config)


class _SharedNodes:
    """Nodes in use by transport and settings, each with the number of its users."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._nodes: dict[tuple[TransportName, Ros2Config], tuple[Node, int]] = {}

    def acquire(self, transport: TransportName, config: Ros2Config) -> Node:
        with self._lock:
            node, users = self._nodes.get((transport, config), (None, 0))
            node = node or open_node(transport, config)
            self._nodes[transport, config] = node, users + 1
            return node

    def release(self, transport: TransportName, config: Ros2Config) -> None:
        with self._lock:
            node, users = self._nodes.pop((transport, config))
            if users > 1:
                self._nodes[transport, config] = node, users - 1
                return
        node.close()


_SHARED = _SharedNodes()


@contextmanager
def shared_node(transport: TransportName, config: Ros2Config) -> Iterator[Node]:
    """Provide the node of this process, which its publishers and all its ports share; see `open_node`."""
    node = _SHARED.acquire(transport, config)
    try:
        yield node
    finally:
        _SHARED.release(transport, config)
