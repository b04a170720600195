"""Events about the connection of one port, throttled while it keeps failing."""

from __future__ import annotations

from hubodo.ingest.link.link import LinkLost, LinkUp
from hubodo.ingest.link.throttle import EventThrottle
from hubodo.log.records import EventRecord, Sink
from hubodo.recording import Event


class Connection:
    """The state of one port's connection, with events for each time it opens and closes.

    Connections that are lost in a row before any valid data was received are reported at growing intervals.
    """

    def __init__(self, label: str, sink: Sink) -> None:
        self.label = label
        self.endpoint: str | None = None
        """Name of the open device or address; None while the port is not open."""
        self.disconnections = 0
        self.faults = 0
        """Unexpected exceptions of the port's driver."""
        self.is_valid = False
        """True once valid data was received since the port was opened."""
        self._sink = sink
        self._notices: list[Event] = []
        self._was_lost = False
        self._loss_throttle = EventThrottle()
        self._is_withheld = False
        self._withheld_up: Event | None = None

    def handle_up(self, report: LinkUp) -> None:
        """Handle the opening of the port."""
        self.endpoint, self.is_valid = report.endpoint, False
        text = f"{self.label}: connected at {report.endpoint}"
        event = Event(
            report.t_ns, "connected", self.label, text, {"link": self.label, "where": report.endpoint}
        )
        if self._is_withheld:
            self._withheld_up = event
        else:
            self._report_up(event)

    def mark_valid(self) -> None:
        """Mark the connection as carrying valid data, so that its loss is reported at once."""
        if not self.is_valid:
            self.is_valid = True
            self._loss_throttle.reset()
            if self._withheld_up is not None:
                self._report_up(self._withheld_up)
                self._withheld_up = None

    def handle_lost(self, report: LinkLost) -> None:
        """Handle the loss of the port, or a failed attempt to open it."""
        was_open, self.endpoint, self.is_valid = self.endpoint is not None, None, False
        self.disconnections += was_open
        self.faults += report.unexpected
        self._was_lost, self._withheld_up = True, None
        withheld = self._loss_throttle.admit(report.t_ns)
        self._is_withheld = withheld is None
        if withheld is None:
            return
        withheld_text = f"; {withheld} more attempts failed since the last report" if withheld else ""
        state = "disconnected" if was_open else "not available yet"
        text = f"{self.label}: {state}: {report.text}{withheld_text}"
        data = {"link": self.label, "attempts": withheld + 1, "faults": self.faults}
        self._sink.write_record(EventRecord(Event(report.t_ns, "disconnected", self.label, text, data)))
        text = f"{self.label}: {report.text} (waiting for the device){withheld_text}"
        self._notices.append(Event(report.t_ns, "disconnected", self.label, text))

    def take_notices(self) -> list[Event]:
        """Return the events to show to the user that were added since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def _report_up(self, event: Event) -> None:
        self._sink.write_record(EventRecord(event))
        if self._was_lost:
            self._notices.append(event)
