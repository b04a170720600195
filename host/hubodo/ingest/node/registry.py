"""All nodes of a recording: one session per board, created with its first frame, under a unique name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping

from hubodo.ingest.link.session import LinkSession
from hubodo.ingest.node.identity import describe_firmware_difference
from hubodo.ingest.node.log_times import LogTimeSequence
from hubodo.ingest.node.naming import assign_name
from hubodo.ingest.node.session import NodeSession
from hubodo.log.records import Sink
from hubowire import node_name

Transmit = Callable[[str, bytes, str], bool]
"""Sends bytes on a link to an address; returns False if they were not sent."""


class NodeRegistry:
    """The nodes of a recording, in the order of their first frames.

    Parameters
    ----------
    names
        Name of the node by link label; None to derive it from the node id.
    reserved
        Names that no node may get.
    order
        Log times, shared by all nodes.
    clock_period
        Interval of clock requests, s.
    warn
        Called with source and text of a warning.
    """

    def __init__(
        self,
        names: Mapping[str, str | None],
        sink: Sink,
        transmit: Transmit,
        now_ns: Callable[[], int],
        *,
        reserved: Collection[str],
        order: LogTimeSequence,
        clock_period: float,
        warn: Callable[[str, str], None],
    ) -> None:
        self._names, self._sink, self._transmit, self._now_ns = dict(names), sink, transmit, now_ns
        self._reserved, self._order, self._clock_period, self._warn = reserved, order, clock_period, warn
        self._sessions: dict[tuple[str, int, int], NodeSession] = {}
        self._firmware_versions: dict[str, tuple[int, ...]] = {}

    def __iter__(self) -> Iterator[NodeSession]:
        return iter(list(self._sessions.values()))

    def __len__(self) -> int:
        return len(self._sessions)

    def named(self, name: str) -> NodeSession | None:
        """Return the node of this name; None if there is none."""
        return next((node for node in self if node.name == name), None)

    def on_link(self, label: str) -> list[NodeSession]:
        """Return the nodes on a link."""
        return [node for node in self if node.link == label]

    def get_or_create(self, link: LinkSession, node_id: int, board: int) -> NodeSession:
        """Return the session of a board; board: its number among those with this id, 0 on a serial line."""
        key = link.label, node_id, board
        node = self._sessions.get(key)
        if node is None:

            def send(question: bytes) -> bool:
                return self._transmit(link.label, question, link.senders.address(node_id, board))

            node = self._sessions[key] = NodeSession(
                self._choose_name(link.label, node_id),
                link.label,
                node_id,
                send,
                self._sink,
                self._now_ns,
                datagrams=link.datagrams,
                clock_period=self._clock_period,
                order=self._order,
            )
        return node

    def compare_firmware(self) -> str | None:
        """Return a warning if nodes run different firmware, once per change, else None."""
        hellos = ((node.name, node.decoder.hello) for node in self)
        versions = {name: tuple(hello.firmware) for name, hello in hellos if hello is not None}
        if versions == self._firmware_versions:
            return None
        self._firmware_versions = versions
        return describe_firmware_difference(versions)

    def mismatch(self) -> str | None:
        """Return the reason if the nodes of every link use another protocol version, else None."""
        refusals = [node.decoder.mismatch_text for node in self if node.decoder.mismatch_text is not None]
        if refusals and len(refusals) == len(self) and {node.link for node in self} == set(self._names):
            return "; ".join(refusals)
        return None

    def _choose_name(self, label: str, node_id: int) -> str:
        used_names = {*(node.name for node in self), *self._reserved}
        unique, has_clash = assign_name(self._names[label], node_id, used_names)
        if has_clash:
            text = (
                f"{label}: another node called {node_name(node_id)!r} exists already; this one is "
                f"recorded as {unique!r}: give ports names (left=/dev/...) or change the node id"
            )
            self._warn(label, text)
        return unique
