"""NMEA sentences of a GNSS receiver to positions with the receiver's own time and sigmas."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, time, timedelta

import pynmea2

_LINE = re.compile(rb"\$[^\r\n$]{5,120}\*[0-9A-Fa-f]{2}")
_MAX_LINE = 256
_WEEKS = timedelta(weeks=1024)  # the ten bits of the GPS week
_STATUS = {1: 0, 2: 1, 3: 0, 4: 2, 5: 2}  # GGA quality to NavSatStatus; all else is no fix
_MAX_SIGMA, _MAX_HEIGHT = 1e5, 1e5
"""m; what is beyond is a damaged sentence, though its checksum is valid."""
_HALF_DAY = timedelta(hours=12)


@dataclass(frozen=True, slots=True)
class Fix:
    """One position.

    utc_ns: time of validity from the sentences, ns since 1970; None until a date has come. altitude: m
    above the ellipsoid (mean sea level plus the receiver's geoid separation). sigma: m of east, north,
    up from GST, None without one. status: NavSatStatus.
    received_ns: host time of the first sentence of this epoch.
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
    """What came on the line."""

    sentences: int = 0
    checksum_errors: int = 0
    unread: int = 0
    fixes: int = 0


@dataclass(slots=True)
class _Epoch:
    """Sentences that share one time of day."""

    at: time
    received_ns: int
    kinds: set[str] = field(default_factory=set)
    position: tuple[float, float, float] | None = None
    sigma: tuple[float, float, float] | None = None
    quality: int = 0
    satellites: int = 0


class NmeaDecoder:
    """Bytes in any portions to fixes; sans-I/O. Reads GGA, RMC and GST of any talker; empty fields are legal.

    The sentences of one epoch come in an order of the receiver's own; a fix is given as soon as all
    kinds seen in the epoch before are there, or when the next epoch begins.
    """

    def __init__(self) -> None:
        self.counts = NmeaCounts()
        self._buffer = bytearray()
        self._epoch: _Epoch | None = None
        self._usual: set[str] = set()
        self._date: date | None = None
        self._date_at: time | None = None

    def feed(self, data: bytes, t_ns: int) -> Iterator[Fix]:
        """Yields the fixes that the bytes received at host time `t_ns` complete."""
        self._buffer += data
        *lines, rest = self._buffer.split(b"\n")
        self._buffer = bytearray(rest[-_MAX_LINE:])
        for line in lines:
            match = _LINE.search(line)
            if match is not None:
                yield from self._sentence(match[0].decode("ascii", "replace"), t_ns)

    def finish(self) -> Iterator[Fix]:
        """The last epoch, though sentences of it may be missing."""
        yield from self._close()

    def _sentence(self, text: str, t_ns: int) -> Iterator[Fix]:
        try:
            sentence = pynmea2.parse(text, check=True)
        except pynmea2.ChecksumError:
            self.counts.checksum_errors += 1
            return
        except Exception:  # noqa: BLE001 pynmea2 raises whatever a field with a valid checksum leads to
            self.counts.unread += 1
            return
        self.counts.sentences += 1
        kind = getattr(sentence, "sentence_type", "")
        if kind not in ("GGA", "RMC", "GST"):
            return
        at = _field(sentence, "timestamp")
        if not isinstance(at, time):
            return
        at = at.replace(tzinfo=None)
        if self._epoch is not None and self._epoch.at != at:
            yield from self._close()
        if self._epoch is None:
            self._epoch = _Epoch(at, t_ns)
        epoch = self._epoch
        epoch.kinds.add(kind)
        if kind == "RMC":
            self._take_date(sentence, at, t_ns)
        elif kind == "GST":
            east, north, up = (_number(sentence, name, 0.0, _MAX_SIGMA) for name in _GST_FIELDS)
            if east and north and up:  # some receivers write zeros for what they do not know
                epoch.sigma = (east, north, up)
        else:
            self._take_position(sentence, epoch)
        if self._usual and self._usual <= epoch.kinds:
            yield from self._close()

    def _take_position(self, sentence: pynmea2.NMEASentence, epoch: _Epoch) -> None:
        epoch.quality = int(_number(sentence, "gps_qual", 0.0, 9.0) or 0)
        epoch.satellites = int(_number(sentence, "num_sats", 0.0, 999.0) or 0)
        if not getattr(sentence, "lat", "") or not getattr(sentence, "lon", ""):
            return
        height = _number(sentence, "altitude", -_MAX_HEIGHT, _MAX_HEIGHT)
        separation = _number(sentence, "geo_sep", -_MAX_HEIGHT, _MAX_HEIGHT) or 0.0
        altitude = float("nan") if height is None else height + separation
        latitude = _number(sentence, "latitude", -90.0, 90.0)
        longitude = _number(sentence, "longitude", -180.0, 180.0)
        if latitude is None or longitude is None:
            self.counts.unread += 1
            return
        epoch.position = (latitude, longitude, altitude)

    def _take_date(self, sentence: pynmea2.NMEASentence, at: time, t_ns: int) -> None:
        found = _field(sentence, "datestamp")
        if not isinstance(found, date):
            return
        # A receiver past its week rollover reports 1024 weeks too early: no recording is older than itself.
        today = datetime.fromtimestamp(t_ns * 1e-9, UTC).date()
        while found + _WEEKS / 2 < today:
            found += _WEEKS
        self._date, self._date_at = found, at

    def _close(self) -> Iterator[Fix]:
        epoch, self._epoch = self._epoch, None
        if epoch is None:
            return
        self._usual = epoch.kinds
        if epoch.position is None or epoch.quality == 0:  # without a fix some repeat the last position
            return
        self.counts.fixes += 1
        latitude, longitude, altitude = epoch.position
        yield Fix(
            utc_ns=self._utc_ns(epoch.at),
            latitude_deg=latitude,
            longitude_deg=longitude,
            altitude=altitude,
            sigma=epoch.sigma,
            status=_STATUS.get(epoch.quality, -1),
            satellites=epoch.satellites,
            received_ns=epoch.received_ns,
        )

    def _utc_ns(self, at: time) -> int | None:
        """Date of the newest RMC joined with a time of day that may lie on the other side of midnight."""
        if self._date is None or self._date_at is None:
            return None
        moment = datetime.combine(self._date, at, UTC)
        reference = datetime.combine(self._date, self._date_at, UTC)
        if moment - reference > _HALF_DAY:
            moment -= timedelta(days=1)
        elif reference - moment > _HALF_DAY:
            moment += timedelta(days=1)
        since = moment - datetime(1970, 1, 1, tzinfo=UTC)
        return ((since.days * 86400 + since.seconds) * 1_000_000 + since.microseconds) * 1000


_GST_FIELDS = ("std_dev_longitude", "std_dev_latitude", "std_dev_altitude")


def _field(sentence: pynmea2.NMEASentence, name: str) -> object:
    """Return a field as pynmea2 reads it, None where it cannot."""
    try:
        return getattr(sentence, name)
    except Exception:  # noqa: BLE001 as above: ValueError, decimal.InvalidOperation, IndexError, ...
        return None


def _number(sentence: pynmea2.NMEASentence, name: str, least: float, most: float) -> float | None:
    """Return a number of a sentence, None where it is missing, not a number, or out of bounds."""
    try:
        value = float(_field(sentence, name))  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None
    return value if least <= value <= most else None
