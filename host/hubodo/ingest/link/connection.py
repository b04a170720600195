"""A port that comes and goes, as events: each while they are rare, then with counts at growing intervals."""

from __future__ import annotations

from hubodo.ingest.link.link import LinkLost, LinkUp
from hubodo.ingest.link.throttle import EventThrottle
from hubodo.ingest.sink import Sink
from hubodo.recording import Event


class Connection:
    """Whether a port is open, and how often it was lost.

    Of connections that are lost before anything valid came, one after the other, not each is an event.
    """

    def __init__(self, label: str, sink: Sink) -> None:
        self.label = label
        self.where: str | None = None
        """The device of today, None while it is not open."""
        self.disconnections = 0
        self.faults = 0
        """Unexpected exceptions of the port's driver."""
        self.is_valid = False
        """True once something valid has come since the port is open."""
        self._sink = sink
        self._notices: list[Event] = []
        self._was_lost = False
        self._loss_throttle = EventThrottle()
        self._is_withheld = False
        self._withheld_up: Event | None = None

    def handle_up(self, report: LinkUp) -> None:
        """The port is open."""
        self.where, self.is_valid = report.where, False
        text = f"{self.label}: connected at {report.where}"
        event = Event(report.t_ns, "connected", self.label, text, {"link": self.label, "where": report.where})
        if self._is_withheld:
            self._withheld_up = event
        else:
            self._report_up(event)

    def mark_valid(self) -> None:
        """Something valid has come: the next loss is an event again."""
        if not self.is_valid:
            self.is_valid = True
            self._loss_throttle.reset()
            if self._withheld_up is not None:
                self._report_up(self._withheld_up)
                self._withheld_up = None

    def handle_lost(self, report: LinkLost) -> None:
        """The port has gone, or could not be opened."""
        was_open, self.where, self.is_valid = self.where is not None, None, False
        self.disconnections += was_open
        self.faults += report.unexpected
        self._was_lost, self._withheld_up = True, None
        withheld = self._loss_throttle.admit(report.t_ns)
        self._is_withheld = withheld is None
        if withheld is None:
            return
        withheld_text = f"; {withheld} more attempts failed since the last report" if withheld else ""
        text = (
            f"{self.label}: {'disconnected' if was_open else 'not there yet'}: {report.text}{withheld_text}"
        )
        data = {"link": self.label, "attempts": withheld + 1, "faults": self.faults}
        self._sink.write_event(Event(report.t_ns, "disconnected", self.label, text, data))
        text = f"{self.label}: {report.text} (waiting for it){withheld_text}"
        self._notices.append(Event(report.t_ns, "disconnected", self.label, text))

    def take_notices(self) -> list[Event]:
        """Return what the user should see since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def _report_up(self, event: Event) -> None:
        self._sink.write_event(event)
        if self._was_lost:
            self._notices.append(event)
