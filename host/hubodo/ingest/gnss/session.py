"""Logging of a GNSS receiver's sentences and fixes on the host clock."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from hubodo.ingest.gnss.nmea import Fix, NmeaDecoder
from hubodo.ingest.link.connection import Connection
from hubodo.ingest.live.localizer import FixSample, horizontal_sigma
from hubodo.ingest.node.log_times import LogTimeSequence
from hubodo.log.records import EventRecord, GnssFix, NmeaBytes, Sink
from hubodo.recording import Event

_MAX_CLOCK_DIFFERENCE_NS = 2_000_000_000


class GnssSession:
    """One receiver: its bytes are logged as received, then its fixes.

    A fix carries the UTC time of its sentences. Where the host clock differs by more than 2 s, fixes are
    shifted to the host clock by the smallest difference observed (late by the receiver's minimum delay), and
    an event reports it.
    """

    def __init__(self, label: str, sink: Sink, order: LogTimeSequence | None = None) -> None:
        """Start without fixes.

        order: source of unique log times, shared by all nodes and receivers of the recording.
        """
        self.label = label
        self.connection = Connection(label, sink)
        self.decoder = NmeaDecoder()
        self.last_fix: Fix | None = None
        self._sink = sink
        self._order = order or LogTimeSequence()
        self._shift_ns = 0
        self._first_delay_ns: int | None = None
        self._newest_ns = 0

    def handle_bytes(self, data: bytes, t_ns: int) -> list[FixSample]:
        """Log bytes of the receiver and return the fixes that they complete."""
        self._sink.write_record(NmeaBytes(t_ns, data))
        sentences_before = self.decoder.counts.sentences
        fixes = list(self._log_fixes(self.decoder.feed(data, t_ns)))
        if self.decoder.counts.sentences > sentences_before:
            self.connection.mark_valid()
        return fixes

    def close(self) -> list[FixSample]:
        """Log and return the fix of the last epoch."""
        return list(self._log_fixes(self.decoder.flush()))

    def _log_fixes(self, fixes: Iterable[Fix]) -> Iterator[FixSample]:
        for fix in fixes:
            self.last_fix = fix
            t_ns = self._host_time_ns(fix)
            if t_ns <= self._newest_ns:
                continue
            self._newest_ns = t_ns
            self._sink.write_record(
                GnssFix(
                    t_ns,
                    self._order.next_time(fix.received_ns),
                    fix.latitude_deg,
                    fix.longitude_deg,
                    fix.altitude,
                    fix.sigma,
                    fix.status,
                )
            )
            if fix.status >= 0:
                horizontal = (
                    None if fix.sigma is None else horizontal_sigma(fix.sigma[0] ** 2, fix.sigma[1] ** 2)
                )
                yield FixSample(t_ns, fix.latitude_deg, fix.longitude_deg, horizontal)

    def _host_time_ns(self, fix: Fix) -> int:
        if fix.utc_ns is None:
            return fix.received_ns
        delay_ns = fix.received_ns - fix.utc_ns
        if self._first_delay_ns is None:
            self._first_delay_ns = delay_ns
            if not -_MAX_CLOCK_DIFFERENCE_NS < delay_ns < _MAX_CLOCK_DIFFERENCE_NS:
                self._shift_ns = delay_ns
                text = (
                    f"{self.label}: the host's clock is {delay_ns * 1e-9:+.1f} s off GNSS time; fixes are "
                    "shifted to the host's clock, late by the receiver's delay; set the host's clock"
                )
                self._sink.write_record(
                    EventRecord(
                        Event(fix.received_ns, "clock", self.label, text, {"offset": delay_ns * 1e-9})
                    )
                )
        elif self._shift_ns and delay_ns < self._shift_ns:
            self._shift_ns = delay_ns
        return fix.utc_ns + self._shift_ns
