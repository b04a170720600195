"""A fake GNSS receiver on a pseudo terminal: GGA, RMC and GST of wherever a function says it is."""

from __future__ import annotations

import os
import threading
import time
import tty
from collections.abc import Callable
from datetime import UTC, datetime


class FakeReceiver:
    """Runs inside `with`.

    place(s since the start) -> latitude, longitude in degrees, 1 sigma in m; told `late` s after it was true.
    """

    def __init__(
        self, place: Callable[[float], tuple[float, float, float]], rate_hz: float = 5.0, late: float = 0.05
    ) -> None:
        self._place, self._period, self._late = place, 1.0 / rate_hz, late
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> FakeReceiver:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(5)
        os.close(self._slave)
        os.close(self._master)

    def _run(self) -> None:
        began = time.monotonic()
        while not self._stop.wait(self._period):
            since = time.monotonic() - began
            now = datetime.fromtimestamp(time.time(), UTC)
            latitude, longitude, sigma = self._place(since)
            if self._stop.wait(self._late):
                return
            os.write(self._master, sentences(now, latitude, longitude, sigma))


def sentences(at: datetime, latitude: float, longitude: float, sigma: float) -> bytes:
    """One epoch, as NMEA 0183 has it."""
    clock = at.strftime("%H%M%S.%f")[:-3]
    place = f"{_degrees(latitude, 2)},{'NS'[latitude < 0]},{_degrees(longitude, 3)},{'EW'[longitude < 0]}"
    lines = (
        f"GPGGA,{clock},{place},1,09,0.9,400.0,M,47.0,M,,",
        f"GPRMC,{clock},A,{place},0.0,0.0,{at:%d%m%y},,,A",
        f"GPGST,{clock},1.0,{sigma},{sigma},0.0,{sigma},{sigma},{2 * sigma}",
    )
    return b"".join(_checked(line) for line in lines)


def _degrees(value: float, digits: int) -> str:
    whole = int(abs(value))
    return f"{whole:0{digits}d}{60.0 * (abs(value) - whole):010.7f}"


def _checked(line: str) -> bytes:
    check = 0
    for byte in line.encode():
        check ^= byte
    return f"${line}*{check:02X}\r\n".encode()
