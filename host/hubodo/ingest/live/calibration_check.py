"""Check during a recording that a calibration belongs to the boards whose samples it is applied to."""

from __future__ import annotations

from hubodo.calibration.apply import check_serial
from hubodo.calibration.file import Calibration
from hubodo.errors import CalibrationError
from hubodo.ingest.live.odometer import Odometer
from hubodo.ingest.node.identity import hello_metadata
from hubodo.ingest.node.session import NodeSession
from hubodo.log.records import EventRecord, Sink
from hubodo.recording import Event


class CalibrationCheck:
    """Compares the serial number of each node with the calibration and reports a mismatch."""

    def __init__(self, calibration: Calibration, sink: Sink, notices: list[Event]) -> None:
        self.error: CalibrationError | None = None
        """Mismatch detected before the odometry gave a pose; None without one."""
        self._calibration = calibration
        self._sink = sink
        self._notices = notices
        self._matches: dict[tuple[str, str], bool] = {}
        self._nodes_with_ranges: set[str] = set()

    def can_use(self, odometer: Odometer, node: NodeSession | None, name: str, now_ns: int) -> bool:
        """Return True if the samples of a node can be used; the odometer learns its measurement ranges."""
        calibrated = self._calibration.nodes.get(name)
        hello = None if node is None else node.decoder.hello
        if hello is None:
            return True
        if name not in self._nodes_with_ranges:
            self._nodes_with_ranges.add(name)
            odometer.update_ranges(name, hello_metadata(hello))
        if calibrated is None:
            return True
        serial = hello.serial.hex()
        if (name, serial) not in self._matches:
            try:
                check_serial(name, calibrated, serial)
                self._matches[name, serial] = True
            except CalibrationError as error:
                self._matches[name, serial] = False
                if not odometer.pose_count:
                    self.error = error
                data = {"node": name, "serial": serial, "calibrated": calibrated.serial}
                text = f"{error}; its samples are recorded but not used for odometry"
                self._notices.append(Event(now_ns, "mismatch", name, text))
                self._sink.write_record(EventRecord(Event(now_ns, "mismatch", name, str(error), data)))
        return self._matches[name, serial]
