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
        self.downs = 0
        self.faults = 0
        """Unexpected exceptions of the port's driver."""
        self.is_valid = False
        """True once something valid has come since the port is open."""
        self._sink = sink
        self._notices: list[Event] = []
        self._missed = False
        self._losses = EventThrottle()
        self._is_withheld = False
        self._withheld: Event | None = None

    def up(self, news: LinkUp) -> None:
        """The port is open."""
        self.where, self.is_valid = news.where, False
        text = f"{self.label}: connected at {news.where}"
        event = Event(news.t_ns, "connected", self.label, text, {"link": self.label, "where": news.where})
        if self._is_withheld:
            self._withheld = event
        else:
            self._report_up(event)

    def mark_valid(self) -> None:
        """Something valid has come: the next loss is an event again."""
        if not self.is_valid:
            self.is_valid = True
            self._losses.reset()
            if self._withheld is not None:
                self._report_up(self._withheld)
                self._withheld = None

    def lost(self, news: LinkLost) -> None:
        """The port has gone, or could not be opened."""
        was_open, self.where, self.is_valid = self.where is not None, None, False
        self.downs += was_open
        self.faults += news.unexpected
        self._missed, self._withheld = True, None
        before = self._losses.admit(news.t_ns)
        self._is_withheld = before is None
        if before is None:
            return
        more = f"; {before} more attempts failed since the last report" if before else ""
        text = f"{self.label}: {'disconnected' if was_open else 'not there yet'}: {news.text}{more}"
        data = {"link": self.label, "attempts": before + 1, "faults": self.faults}
        self._sink.write_event(Event(news.t_ns, "disconnected", self.label, text, data))
        text = f"{self.label}: {news.text} (waiting for it){more}"
        self._notices.append(Event(news.t_ns, "disconnected", self.label, text))

    def take_notices(self) -> list[Event]:
        """Return what the user should see since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def _report_up(self, event: Event) -> None:
        self._sink.write_event(event)
        if self._missed:
            self._notices.append(event)
