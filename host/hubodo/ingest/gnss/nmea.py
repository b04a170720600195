"""Decoder of NMEA sentences to GNSS fixes with UTC time and standard deviations."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, time, timedelta

import pynmea2

_SENTENCE = re.compile(rb"\$[^\r\n$]{5,120}\*[0-9A-Fa-f]{2}")
_MAX_LINE_BYTES = 256
_GPS_WEEK_ROLLOVER = timedelta(weeks=1024)  # the GPS week number has ten bits
_NAV_SAT_STATUS = {1: 0, 2: 1, 3: 0, 4: 2, 5: 2}  # GGA quality to NavSatStatus; any other quality is no fix
_MAX_SIGMA_M, _MAX_HEIGHT_M = 1e5, 1e5
"""m; a sentence beyond these bounds is damaged although its checksum is valid."""
_HALF_DAY = timedelta(hours=12)


@dataclass(frozen=True, slots=True)
class Fix:
    """One GNSS fix.

    Attributes
    ----------
    utc_ns
        Time of validity from the sentences, ns since 1970; None until a date was received.
    altitude
        m above the ellipsoid (mean sea level plus the receiver's geoid separation).
    sigma
        Standard deviation of east, north, up in m from GST; None without GST.
    status
        NavSatStatus.
    received_ns
        Host time of the first sentence of this epoch.
    """

    utc_ns: int | None
    latitude_deg: float
    longitude_deg: float
    altitude: float
    sigma: tuple[float, float, float] | None
    status: int
    satellites: int
    received_ns: int


@dataclass(slots=True)
class NmeaCounts:
    """Numbers of sentences, errors and fixes of a receiver."""

    sentences: int = 0
    checksum_errors: int = 0
    unparsed: int = 0
    fixes: int = 0


@dataclass(slots=True)
class _Epoch:
    """The sentences of one epoch, which carry the same time of day."""

    time_of_day: time
    received_ns: int
    kinds: set[str] = field(default_factory=set)
    position: tuple[float, float, float] | None = None
    sigma: tuple[float, float, float] | None = None
    quality: int = 0
    satellites: int = 0


class NmeaDecoder:
    """A sans-I/O decoder of GGA, RMC and GST sentences of any talker; empty fields are legal.

    The order of the sentences in one epoch depends on the receiver: a fix is returned as soon as all
    kinds of sentence of the previous epoch were received, or when the next epoch begins.
    """

    def __init__(self) -> None:
        self.counts = NmeaCounts()
        self._buffer = bytearray()
        self._epoch: _Epoch | None = None
        self._expected_kinds: set[str] = set()
        self._date: date | None = None
        self._date_time_of_day: time | None = None

    def feed(self, data: bytes, t_ns: int) -> Iterator[Fix]:
        """Yield the fixes completed by the bytes received at host time `t_ns`."""
        self._buffer += data
        *lines, tail = self._buffer.split(b"\n")
        self._buffer = bytearray(tail[-_MAX_LINE_BYTES:])
        for line in lines:
            match = _SENTENCE.search(line)
            if match is not None:
                yield from self._parse_sentence(match[0].decode("ascii", "replace"), t_ns)

    def flush(self) -> Iterator[Fix]:
        """Yield the fix of the last epoch, although sentences of it may be missing."""
        yield from self._close_epoch()

    def _parse_sentence(self, text: str, t_ns: int) -> Iterator[Fix]:
        try:
            sentence = pynmea2.parse(text, check=True)
        except pynmea2.ChecksumError:
            self.counts.checksum_errors += 1
            return
        except Exception:  # noqa: BLE001 pynmea2 may raise anything for a malformed field
            self.counts.unparsed += 1
            return
        self.counts.sentences += 1
        kind = getattr(sentence, "sentence_type", "")
        if kind not in ("GGA", "RMC", "GST"):
            return
        time_of_day = _read_field(sentence, "timestamp")
        if not isinstance(time_of_day, time):
            return
        time_of_day = time_of_day.replace(tzinfo=None)
        if self._epoch is not None and self._epoch.time_of_day != time_of_day:
            yield from self._close_epoch()
        if self._epoch is None:
            self._epoch = _Epoch(time_of_day, t_ns)
        epoch = self._epoch
        epoch.kinds.add(kind)
        if kind == "RMC":
            self._read_date(sentence, time_of_day, t_ns)
        elif kind == "GST":
            east, north, up = (_read_number(sentence, name, 0.0, _MAX_SIGMA_M) for name in _GST_FIELDS)
            if east and north and up:  # some receivers send zeros for unknown values
                epoch.sigma = (east, north, up)
        else:
            self._read_position(sentence, epoch)
        if self._expected_kinds and self._expected_kinds <= epoch.kinds:
            yield from self._close_epoch()

    def _read_position(self, sentence: pynmea2.NMEASentence, epoch: _Epoch) -> None:
        epoch.quality = int(_read_number(sentence, "gps_qual", 0.0, 9.0) or 0)
        epoch.satellites = int(_read_number(sentence, "num_sats", 0.0, 999.0) or 0)
        if not getattr(sentence, "lat", "") or not getattr(sentence, "lon", ""):
            return
        height = _read_number(sentence, "altitude", -_MAX_HEIGHT_M, _MAX_HEIGHT_M)
        separation = _read_number(sentence, "geo_sep", -_MAX_HEIGHT_M, _MAX_HEIGHT_M) or 0.0
        altitude = float("nan") if height is None else height + separation
        latitude = _read_number(sentence, "latitude", -90.0, 90.0)
        longitude = _read_number(sentence, "longitude", -180.0, 180.0)
        if latitude is None or longitude is None:
            self.counts.unparsed += 1
            return
        epoch.position = (latitude, longitude, altitude)

    def _read_date(self, sentence: pynmea2.NMEASentence, time_of_day: time, t_ns: int) -> None:
        utc_date = _read_field(sentence, "datestamp")
        if not isinstance(utc_date, date):
            return
        # After a GPS week rollover, old receivers report dates that are 1024 weeks too early.
        today = datetime.fromtimestamp(t_ns * 1e-9, UTC).date()
        while utc_date + _GPS_WEEK_ROLLOVER / 2 < today:
            utc_date += _GPS_WEEK_ROLLOVER
        self._date, self._date_time_of_day = utc_date, time_of_day

    def _close_epoch(self) -> Iterator[Fix]:
        epoch, self._epoch = self._epoch, None
        if epoch is None:
            return
        self._expected_kinds = epoch.kinds
        if (
            epoch.position is None or epoch.quality == 0
        ):  # without a fix some receivers repeat the last position
            return
        self.counts.fixes += 1
        latitude, longitude, altitude = epoch.position
        yield Fix(
            utc_ns=self._utc_ns(epoch.time_of_day),
            latitude_deg=latitude,
            longitude_deg=longitude,
            altitude=altitude,
            sigma=epoch.sigma,
            status=_NAV_SAT_STATUS.get(epoch.quality, -1),
            satellites=epoch.satellites,
            received_ns=epoch.received_ns,
        )

    def _utc_ns(self, time_of_day: time) -> int | None:
        """Return a time of day as ns since 1970, on the date that brings it closest to the newest RMC."""
        if self._date is None or self._date_time_of_day is None:
            return None
        moment = datetime.combine(self._date, time_of_day, UTC)
        reference = datetime.combine(self._date, self._date_time_of_day, UTC)
        if moment - reference > _HALF_DAY:
            moment -= timedelta(days=1)
        elif reference - moment > _HALF_DAY:
            moment += timedelta(days=1)
        since = moment - datetime(1970, 1, 1, tzinfo=UTC)
        return ((since.days * 86400 + since.seconds) * 1_000_000 + since.microseconds) * 1000


_GST_FIELDS = ("std_dev_longitude", "std_dev_latitude", "std_dev_altitude")


def _read_field(sentence: pynmea2.NMEASentence, name: str) -> object:
    """Return a field as parsed by pynmea2; None where it cannot be parsed."""
    try:
        return getattr(sentence, name)
    except Exception:  # noqa: BLE001 as above: ValueError, decimal.InvalidOperation, IndexError, ...
        return None


def _read_number(sentence: pynmea2.NMEASentence, name: str, minimum: float, maximum: float) -> float | None:
    """Return a number of a sentence; None where it is missing, not a number, or out of bounds."""
    try:
        value = float(_read_field(sentence, name))  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None
    return value if minimum <= value <= maximum else None
