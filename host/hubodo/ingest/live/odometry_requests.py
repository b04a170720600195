"""Requests of other programs during a recording: set the pose of the odometry, find the gyro biases."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from hubodo.arrays import Array
from hubodo.ingest.live.odometer import Odometer
from hubodo.ingest.node.log_times import LogTimeSequence
from hubodo.ingest.node.session import NodeSession
from hubodo.log.pose_events import pose_event
from hubodo.log.records import EventRecord, Sink
from hubodo.recording import Event
from hubodo.units import NS_PER_S
from hubowire.messages import BiasInit

BIAS_SAMPLES = 2000
"""Samples of a bias initialisation, the minimum of a node."""
_BIAS_TIMEOUT_NS = 120 * NS_PER_S
"""More than `BIAS_SAMPLES` take at the lowest rate of a chip, about 80 s."""

OnOutcome = Callable[[bool, str], None]
"""Called with success and one line for people, once; must return at once."""


@dataclass(frozen=True, slots=True, eq=False)
class SetPose:
    """Request to set the pose of the vehicle in the frame odom.

    t_ns: host time; source: what asks; x, y, heading: m, m, rad; covariance: (3, 3) of them.
    refusal: why the request was malformed, "" if it was not.
    """

    t_ns: int
    source: str
    x: float
    y: float
    heading: float
    covariance: Array
    on_outcome: OnOutcome
    refusal: str = ""

    def problem(self) -> str:
        """Return why the pose cannot be used, "" if it can."""
        if self.refusal:
            return self.refusal
        if not np.isfinite([self.x, self.y, self.heading, *self.covariance.flat]).all():
            return "the pose is not finite"
        smallest = np.linalg.eigvalsh(0.5 * (self.covariance + self.covariance.T))[0]
        if smallest < -1e-9 * max(1.0, float(np.abs(self.covariance).max())):
            return "the covariance of x, y and yaw is not positive semidefinite"
        return ""


@dataclass(frozen=True, slots=True, eq=False)
class FindBias:
    """Request to initialise the gyro biases of all nodes at standstill; t_ns: host time."""

    t_ns: int
    source: str
    on_outcome: OnOutcome


OdometryRequest = SetPose | FindBias


class _BiasSearch:
    """One `FindBias` in progress: the outcomes of the nodes so far."""

    def __init__(self, request: FindBias, nodes: Iterable[NodeSession]) -> None:
        self.is_over = False
        self._request = request
        self._nodes = list(nodes)
        self._outcomes: dict[str, tuple[bool, str]] = {}

    def start(self) -> None:
        """Ask all nodes; their answers follow at the end of the initialisation."""
        if not self._nodes:
            self._finish(False, "no node is connected")
        for node in self._nodes:
            label = f"bias initialisation over {BIAS_SAMPLES} samples, for {self._request.source}"
            node.request(BiasInit(BIAS_SAMPLES), label, lambda *args, name=node.name: self._note(name, *args))

    def check_timeout(self, now_ns: int) -> None:
        """Give up on nodes that do not answer."""
        if now_ns - self._request.t_ns > _BIAS_TIMEOUT_NS:
            for node in self._nodes:
                self._outcomes.setdefault(node.name, (False, "no answer"))
            self._conclude()

    def _note(self, node: str, success: bool, text: str) -> None:
        self._outcomes[node] = success, text
        if len(self._outcomes) == len(self._nodes):
            self._conclude()

    def _conclude(self) -> None:
        success = all(done for done, _ in self._outcomes.values())
        self._finish(success, "; ".join(f"{node}: {text}" for node, (_, text) in self._outcomes.items()))

    def _finish(self, success: bool, text: str) -> None:
        if not self.is_over:
            self.is_over = True
            self._request.on_outcome(success, text)


class OdometryRequests:
    """Carries out requests; each pose that is set is logged, so that playback repeats it."""

    def __init__(self, odometer: Odometer | None, order: LogTimeSequence, sink: Sink) -> None:
        """Start without requests; order: log times, shared with the samples of all nodes."""
        self._odometer, self._order, self._sink = odometer, order, sink
        self._searches: list[_BiasSearch] = []

    def handle(self, request: OdometryRequest, nodes: Iterable[NodeSession]) -> Event | None:
        """Carry out a request; return an event for the user."""
        if isinstance(request, FindBias):
            search = _BiasSearch(request, nodes)
            self._searches.append(search)
            search.start()
            return None
        return self._set_pose(request)

    def tick(self, now_ns: int) -> None:
        """End searches whose nodes do not answer."""
        for search in self._searches:
            search.check_timeout(now_ns)
        self._searches = [search for search in self._searches if not search.is_over]

    def _set_pose(self, request: SetPose) -> Event:
        problem = "there is no odometry: give --vehicle" if self._odometer is None else request.problem()
        t_ns = self._order.next_time(request.t_ns)
        if self._odometer is None or problem:
            event = Event(t_ns, "warning", "odometry", f"{request.source}: pose refused: {problem}")
        else:
            covariance = 0.5 * (request.covariance + request.covariance.T)
            self._odometer.set_pose(request.x, request.y, request.heading, covariance)
            event = pose_event(
                t_ns, request.source, (request.x, request.y, request.heading), covariance.tolist()
            )
        self._sink.write_record(EventRecord(event))
        request.on_outcome(not problem, event.text)
        return event
