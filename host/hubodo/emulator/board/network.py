"""The Wi-Fi around a virtual board: an access point that comes and goes, the station, a name server."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

NAME_SERVER = ("10.0.0.1", 53)
MULTICAST = ("224.0.0.251", 5353)

REFUSED = -1
"""What `WlanStation.connect` answers where a port raises OSError."""

# Of CYW43_LINK_* and of network.STAT_* with the reasons of ESP-IDF.
_RP2 = {"off": 0, "idle": 0, "joining": 1, "up": 3, "lost": 1, "no network": -2}
_ESP32 = {"off": 1000, "idle": 1000, "joining": 1001, "up": 1010, "lost": 200, "no network": 201}


@dataclass(frozen=True)
class Air:
    """What is around the board. Times in s since it was switched on.

    away: stretches in which the access point is not there. join: what it takes to join it, or to find that
    it is not there. silent: stretches in which the name server does not answer. names: (from when on, name,
    IPv4 address), the last that applies counts. left_joining: the station is joining at power-on, as after
    a soft reset.
    """

    away: tuple[tuple[float, float], ...] = ()
    join: float = 0.3
    silent: tuple[tuple[float, float], ...] = ()
    names: tuple[tuple[float, str, str], ...] = ()
    left_joining: bool = False

    def there(self, t: float) -> bool:
        """Whether the access point is there."""
        return not any(begin <= t < end for begin, end in self.away)

    def reply(self, t: float, query: bytes) -> bytes | None:
        """What the name server says to a query for an IPv4 address: the name behind another, as most are."""
        if any(begin <= t < end for begin, end in self.silent):
            return None
        labels, at = [], 12
        while query[at]:
            labels.append(query[at + 1 : at + 1 + query[at]].decode())
            at += 1 + query[at]
        asked = query[12 : at + 5]
        found = [address for since, name, address in self.names if since <= t and name == ".".join(labels)]
        if not found:
            return query[:2] + struct.pack(">5H", 0x8183, 1, 0, 0, 0) + asked
        other = b"\5other\xc0\x0c"
        alias = b"\xc0\x0c" + struct.pack(">HHIH", 5, 1, 60, len(other)) + other
        address = bytes(int(part) for part in found[-1].split("."))
        a = b"\xc0" + bytes([12 + len(asked) + 12]) + struct.pack(">HHIH", 1, 1, 60, 4) + address
        return query[:2] + struct.pack(">5H", 0x8180, 1, 2, 0, 0) + asked + alias + a


class WlanStation:
    """The board's WLAN interface as its port shows it; `t` is in s and never runs backwards.

    rp2: a join begins anew whenever it is asked for; after a loss nothing happens by itself, and the status
    stays at "joining". esp32: a join that is asked for during a join is refused; after a loss or a failure
    it tries again by itself, as often as it was told (-1: for ever), and says why the last try failed.
    """

    def __init__(self, port: Literal["rp2", "esp32"], air: Air) -> None:
        self.port, self.air = port, air
        self._codes = _RP2 if port == "rp2" else _ESP32
        self._tries, self._tried = -1, 0
        self._state, self._until = "off", 0.0
        self._fresh = True

    @property
    def active(self) -> bool:
        """Whether it is switched on."""
        return self._state != "off"

    def activate(self, on: bool, t: float) -> None:
        """Switches it on or off."""
        if not on:
            self._state = "off"
        elif self._state == "off":
            self._state = "idle"
            if self.air.left_joining and self._fresh:
                self._begin(t)
            self._fresh = False

    def connect(self, t: float) -> int:
        """Begins to join: 0, or REFUSED."""
        self._look(t)
        if self._state == "off" or (self.port == "esp32" and self._joining):
            return REFUSED
        self._tried = 0
        self._begin(t)
        return 0

    def disconnect(self) -> None:
        """Leaves the network, or ends a join."""
        if self._state != "off":
            self._state = "idle"

    def reconnects(self, tries: int) -> None:
        """esp32: how often it tries again by itself."""
        self._tries = tries

    def status(self, t: float) -> int:
        """What the port's status() says."""
        self._look(t)
        return self._codes[self._state]

    def up(self, t: float) -> bool:
        """Whether it is joined."""
        self._look(t)
        return self._state == "up"

    @property
    def _joining(self) -> bool:
        return self._until > 0.0

    def _begin(self, t: float) -> None:
        self._state, self._until = "joining", t + self.air.join

    def _look(self, t: float) -> None:
        """Lets happen what has happened since."""
        if self._state in ("off", "idle"):
            self._until = 0.0
        while self._until and t >= self._until:
            ended, self._until = self._until, 0.0
            self._state = "up" if self.air.there(ended) else "no network"
            if self._state != "up":
                self._try_again(ended)
        if self._state == "up" and not self.air.there(t):
            self._state = "lost"
            self._try_again(t)

    def _try_again(self, t: float) -> None:
        if self.port == "esp32" and (self._tries < 0 or self._tried < self._tries):
            self._tried += 1
            # The status goes on telling why the last try failed.
            self._until = t + self.air.join
