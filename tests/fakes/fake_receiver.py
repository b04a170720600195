"""A fake GNSS receiver in virtual time with GGA, RMC and GST sentences of a given trajectory."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime

from fakes.talker import Talker
from hubodo.ingest.live.virtual_computer import VirtualComputer


def fake_receiver(computer: VirtualComputer, place: Callable[[float], tuple[float, float, float]]) -> Talker:
    """Start a receiver; place(s from now on) -> latitude, longitude in degrees, 1 sigma in m; delay 50 ms."""
    start = computer.now_ns() * 1e-9

    def sentences_at(since: float) -> bytes:
        return sentences(datetime.fromtimestamp(start + since, UTC), *place(since))

    return Talker(computer, 0.2, sentences_at, late=0.05)


def sentences(at: datetime, latitude: float, longitude: float, sigma: float) -> bytes:
    """Return the sentences of one epoch (NMEA 0183)."""
    clock = at.strftime("%H%M%S.%f")[:-3]
    place = f"{_degrees(latitude, 2)},{'NS'[latitude < 0]},{_degrees(longitude, 3)},{'EW'[longitude < 0]}"
    lines = (
        f"GPGGA,{clock},{place},1,09,0.9,400.0,M,47.0,M,,",
        f"GPRMC,{clock},A,{place},0.0,0.0,{at:%d%m%y},,,A",
        f"GPGST,{clock},1.0,{sigma},{sigma},0.0,{sigma},{sigma},{2 * sigma}",
    )
    return b"".join(checked(line) for line in lines)


def _degrees(value: float, digits: int) -> str:
    whole = int(abs(value))
    return f"{whole:0{digits}d}{60.0 * (abs(value) - whole):010.7f}"


def checked(line: str) -> bytes:
    check = 0
    for byte in line.encode():
        check ^= byte
    return f"${line}*{check:02X}\r\n".encode()
