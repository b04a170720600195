"""A virtual node that is connected to a port of a virtual computer."""

from __future__ import annotations

import os

from hubodo.emulator.virtual_node import VirtualNode
from hubodo.ingest.live.virtual_computer import SentBytes, VirtualComputer


class AttachedNode:
    """A `Device` of the virtual computer: a running node, powered on at the computer's present time."""

    def __init__(self, node: VirtualNode, computer: VirtualComputer) -> None:
        self.path = os.path.realpath(node.port)
        self._node, self._zero_ns = node, computer.now_ns()

    def advance_to(self, t_ns: int, sent_count: int | None) -> None:
        """Run the node until `t_ns`; see `Device`."""
        self._node.run_until((t_ns - self._zero_ns) * 1e-9, sent_count or 0)

    def wait_for_writes(self) -> SentBytes:
        """Wait for the node and return its writes; raise HubodoError if the board failed. See `Device`."""
        return [(self._zero_ns + t_ns, count) for t_ns, count in self._node.wait_for_limit()]
