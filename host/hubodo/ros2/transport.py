"""Opens the node of this process on a transport, and shares it among its users."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from hubodo.extras import require_extra
from hubodo.ros2.config import Ros2Config, TransportName
from hubodo.ros2.node import Node


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
