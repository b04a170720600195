"""Odometry of a recording: samples and requests in, poses to the log, warnings to the user."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from hubodo.calibration.file import Calibration
from hubodo.errors import CalibrationError
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.calibration_check import CalibrationCheck
from hubodo.ingest.live.latency import LatencyHistogram
from hubodo.ingest.live.live_map import LiveMap
from hubodo.ingest.live.localizer import FixSample
from hubodo.ingest.live.odometer import Odometer, SpeedSample
from hubodo.ingest.live.odometry_requests import OdometryRequest, OdometryRequests
from hubodo.ingest.live.odometry_rows import OdometryRows
from hubodo.ingest.node.log_times import LogTimeSequence
from hubodo.ingest.node.session import NodeSession
from hubodo.log.records import EventRecord, NodeSamples, Sink
from hubodo.recording import Event

_PART = "odometry"
"""Name of the odometry behind its bulkhead."""


class RecordedOdometry:
    """The odometer of a recording behind its bulkhead; without an odometer only requests do anything.

    Parameters
    ----------
    odometer
        Odometry of the vehicle; None without a vehicle file.
    map
        Receives the poses of the odometer, and fixes.
    calibration
        Calibration whose serial numbers must be those of the nodes.
    order
        Log times, shared with the samples of all nodes.
    notices
        List to which events for the user are added.
    """

    def __init__(
        self,
        odometer: Odometer | None,
        map: LiveMap,
        calibration: Calibration,
        *,
        order: LogTimeSequence,
        sink: Sink,
        now_ns: Callable[[], int],
        notices: list[Event],
        bulkheads: Bulkheads,
    ) -> None:
        self.odometer = odometer
        self.latency = LatencyHistogram()
        """Time from the arrival of samples until their pose is in the log."""
        self._map = map
        self._requests = OdometryRequests(odometer, order, sink)
        self._calibration_check = CalibrationCheck(calibration, sink, notices)
        self._sink, self._now_ns, self._notices, self._bulkheads = sink, now_ns, notices, bulkheads

    @property
    def calibration_error(self) -> CalibrationError | None:
        """Mismatch of calibration and nodes, detected before the first pose; None without one."""
        return self._calibration_check.error

    def add_samples(self, blocks: Iterable[NodeSamples], node: NodeSession | None, arrived_ns: int) -> None:
        """Process samples of a node (None for a ROS 2 topic) and publish the new poses."""
        # Without an odometer as well: the session of a node logs its blocks while they are iterated.
        for block in blocks:
            if self.odometer is not None:
                self._bulkheads.run(_PART, self._process_block, self.odometer, block, node, arrived_ns)

    def add_speeds(self, speeds: SpeedSample, arrived_ns: int) -> None:
        """Process surface speeds of another odometer."""
        if self.odometer is not None:
            self._bulkheads.run(_PART, self._process_speeds, self.odometer, speeds, arrived_ns)

    def add_fixes(self, fixes: Iterable[FixSample], arrived_ns: int) -> None:
        """Pass fixes to the map, after the poses that precede them."""
        if self.odometer is not None:
            self._map.put(fixes, arrived_ns)

    def handle_request(self, request: OdometryRequest, nodes: Iterable[NodeSession]) -> None:
        """Carry out a request of another program; a fault is its outcome."""
        if not self._bulkheads.run(_PART, self._carry_out, request, nodes):
            request.on_outcome(False, "a fault, see the events of the recording")

    def tick(self, now_ns: int) -> None:
        """End requests without an answer, and report new warnings."""
        self._bulkheads.run("requests", self._requests.tick, now_ns)
        self._bulkheads.run(_PART, self._report_warnings, now_ns)

    def close(self, now_ns: int) -> None:
        """Publish what the odometer still holds, and report the last warnings."""
        self._bulkheads.run(_PART, self._finish, now_ns)

    def _process_block(
        self, odometer: Odometer, block: NodeSamples, node: NodeSession | None, arrived_ns: int
    ) -> None:
        if self._calibration_check.can_use(odometer, node, block.node, arrived_ns):
            self._publish(odometer, odometer.handle(block), arrived_ns)

    def _process_speeds(self, odometer: Odometer, speeds: SpeedSample, arrived_ns: int) -> None:
        odometer.add_surface_speeds(speeds)
        self._publish(odometer, [], arrived_ns)

    def _publish(self, odometer: Odometer, motions: Iterable[OdometryRows], arrived_ns: int) -> None:
        for motion in motions:
            motion.write(self._sink, self._now_ns())
            self.latency.add(self._now_ns() - arrived_ns)
        self._map.put(odometer.take_poses(), arrived_ns)

    def _carry_out(self, request: OdometryRequest, nodes: Iterable[NodeSession]) -> None:
        event = self._requests.handle(request, nodes)
        if event is not None:
            self._notices.append(event)

    def _finish(self, now_ns: int) -> None:
        if self.odometer is not None:
            self._publish(self.odometer, self.odometer.finish(), now_ns)
        self._report_warnings(now_ns, end=True)

    def _report_warnings(self, now_ns: int, *, end: bool = False) -> None:
        """Report the new warnings of the odometer to the user and the log."""
        if self.odometer is None:
            return
        for line in self.odometer.warnings(end=end):
            self._notices.append(Event(now_ns, "warning", "odometry", f"odometry: {line}"))
            self._sink.write_record(EventRecord(Event(now_ns, "warning", "odometry", line)))
