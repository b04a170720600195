"""A ROS 2 topic as a link: up while another node publishes it, its messages added to the recorder's queue."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack

from hubodo.errors import LinkError
from hubodo.ingest.link.link import Inbox, LinkLost, LinkUp, TopicMessage
from hubodo.ingest.topic.port import ROLE_TYPES, TopicPort, TopicRole
from hubodo.ros2.config import Ros2Config
from hubodo.ros2.names import QosProfile
from hubodo.ros2.node import Node
from hubodo.ros2.transport import shared_node

_CHECK_INTERVAL_S = 0.1
_DISCOVERY_TIMEOUT_S = 3.0
"""Publishers are discovered within about a second; Cyclone DDS announces itself once per second."""
_QOS = QosProfile(is_reliable=False, is_transient_local=False, depth=500)
"""Best effort, which publishers of either kind of reliability serve; more than a second of samples."""
_MAX_CLOCK_READ_NS = 20_000
_CLOCK_STEP_NS = 50_000
"""Offsets between the clocks are read this exactly; smaller changes are noise of the reading."""


_OPTIONS: Mapping[TopicRole, str] = {"node": "NAME=", "wheels": "wheels=", "gnss": "--gnss "}
"""Prefix of a port of each role on the command line."""


class TopicLink:
    """The link of one topic; see `Link` of `hubodo.ingest.live.computer`."""

    def __init__(
        self,
        port: TopicPort,
        reports: Inbox,
        now_ns: Callable[[], int],
        wall_ns: Callable[[], int],
        config: Ros2Config,
    ) -> None:
        """Start without a ROS 2 node; config: completed settings."""
        self.port = port
        self._reports, self._now_ns, self._wall_ns, self._config = reports, now_ns, wall_ns, config
        self._resources = ExitStack()
        self._node: Node | None = None
        self._subscribed: set[str] = set()
        self._is_up = self._loss_reported = False
        self._wall_offset_ns = now_ns() - wall_ns()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"topic {port.label}", daemon=True)

    def open_now(self) -> None:
        """Subscribe; raise LinkError if no node publishes the topic with a type that can be recorded."""
        self._join_graph()
        end = time.monotonic() + _DISCOVERY_TIMEOUT_S
        while not self._check_publisher():
            if time.monotonic() > end:
                raise LinkError(self._describe_absence())
            time.sleep(_CHECK_INTERVAL_S)

    def start(self) -> None:
        """Start the thread that watches for publishers."""
        self._thread.start()

    def send(self, data: bytes, to: str = "") -> bool:
        """Return False: nothing is sent to the publisher of a topic."""
        return False

    def request_stop(self) -> None:
        """Stop passing messages on."""
        self._stopping.set()

    def stop(self, timeout_s: float = 1.0) -> None:
        """End the thread and leave the graph."""
        self.request_stop()
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        self._resources.close()

    def _run(self) -> None:
        while not self._stopping.wait(_CHECK_INTERVAL_S):
            try:
                self._join_graph()
                self._check_publisher()
            except Exception as error:  # noqa: BLE001 a transport may raise anything; the next check tries again
                self._report_lost(f"unexpected error: {type(error).__name__}: {error}", unexpected=True)

    def _join_graph(self) -> None:
        if self._node is None:
            transport = self._config.publish or self._config.transport
            self._node = self._resources.enter_context(shared_node(transport, self._config))

    def _check_publisher(self) -> bool:
        """Report whether the topic has a publisher, if that has changed; return True if it has."""
        assert self._node is not None
        published = self._node.published_types().get(self.port.topic, frozenset())
        accepted = [kind for kind in ROLE_TYPES[self.port.role] if kind in published]
        if accepted and not self._is_up:
            endpoint = f"ros2:{self.port.topic} ({accepted[0]})"
            self._is_up, self._loss_reported = True, False
            self._reports.put(LinkUp(self.port.label, self._now_ns(), endpoint, datagrams=False))
        if accepted and accepted[0] not in self._subscribed:
            self._subscribed.add(accepted[0])
            on_message = functools.partial(self._pass_on, accepted[0])
            self._node.subscribe(self.port.topic, accepted[0], _QOS, on_message)
        if not accepted:
            self._report_lost(self._describe_absence())
        return bool(accepted)

    def _pass_on(self, message_type: str, payload: bytes) -> None:
        if not self._stopping.is_set():
            before_ns, wall_ns, t_ns = self._now_ns(), self._wall_ns(), self._now_ns()
            offset_ns = t_ns - wall_ns
            if (
                t_ns - before_ns < _MAX_CLOCK_READ_NS
                and abs(offset_ns - self._wall_offset_ns) > _CLOCK_STEP_NS
            ):
                self._wall_offset_ns = offset_ns
            self._reports.put(
                TopicMessage(self.port.label, before_ns, self._wall_offset_ns, message_type, payload)
            )

    def _report_lost(self, text: str, *, unexpected: bool = False) -> None:
        if self._is_up or not self._loss_reported:
            self._is_up, self._loss_reported = False, True
            self._reports.put(LinkLost(self.port.label, self._now_ns(), text, unexpected))

    def _describe_absence(self) -> str:
        """Return why the topic cannot be recorded now, and what to do."""
        assert self._node is not None
        topic, accepted = self.port.topic, ROLE_TYPES[self.port.role]
        published = self._node.published_types()
        if topic in published:
            kinds = ", ".join(sorted(published[topic]))
            return (
                f"ros2:{topic}: is {kinds}, not {' or '.join(accepted)}{self._suggest_role(published[topic])}"
            )
        others = sorted(name for name, kinds in published.items() if kinds & set(accepted))
        return (
            f"ros2:{topic}: nobody publishes it in domain {self._config.domain}; "
            f"topics of its type: {', '.join(others) or 'none'}"
        )

    def _suggest_role(self, kinds: frozenset[str]) -> str:
        roles = (role for role, accepted in ROLE_TYPES.items() if kinds & set(accepted))
        return "".join(f"; write {_OPTIONS[role]}ros2:{self.port.topic}" for role in roles)
