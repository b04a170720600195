"""Wi-Fi environment of a virtual board: an access point with outages, the station, and a DNS server."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

NAME_SERVER = ("10.0.0.1", 53)
MULTICAST = ("224.0.0.251", 5353)

CONNECT_REFUSED = -1
"""Result of `WlanStation.connect` where the port raises OSError."""

# Values of CYW43_LINK_*, and of network.STAT_* with the disconnect reasons of ESP-IDF.
_STATUS_RP2 = {"off": 0, "idle": 0, "joining": 1, "up": 3, "lost": 1, "no network": -2}
_STATUS_ESP32 = {"off": 1000, "idle": 1000, "joining": 1001, "up": 1010, "lost": 200, "no network": 201}


@dataclass(frozen=True)
class WifiEnvironment:
    """Wi-Fi environment of a board; times in s since power-on.

    Attributes
    ----------
    outages : intervals without access point.
    join_time : s, to join the access point, or to find that it is missing.
    dns_outages : intervals in which the DNS server does not reply.
    dns_records : (valid from, name, IPv4 address); the last valid one applies.
    joining_at_power_on : True if the station is joining at power-on, as after a soft reset.
    """

    outages: tuple[tuple[float, float], ...] = ()
    join_time: float = 0.3
    dns_outages: tuple[tuple[float, float], ...] = ()
    dns_records: tuple[tuple[float, str, str], ...] = ()
    joining_at_power_on: bool = False

    def is_reachable(self, t: float) -> bool:
        """Return True if the access point is available at t."""
        return not any(start <= t < end for start, end in self.outages)

    def answer_dns(self, t: float, query: bytes) -> bytes | None:
        """Return the DNS reply to a query for an IPv4 address, through an alias; None during an outage."""
        if any(start <= t < end for start, end in self.dns_outages):
            return None
        labels, offset = [], 12
        while query[offset]:
            labels.append(query[offset + 1 : offset + 1 + query[offset]].decode())
            offset += 1 + query[offset]
        question = query[12 : offset + 5]
        addresses = [
            address for since, name, address in self.dns_records if since <= t and name == ".".join(labels)
        ]
        if not addresses:
            return query[:2] + struct.pack(">5H", 0x8183, 1, 0, 0, 0) + question
        canonical_name = b"\5other\xc0\x0c"
        alias = b"\xc0\x0c" + struct.pack(">HHIH", 5, 1, 60, len(canonical_name)) + canonical_name
        address = bytes(int(part) for part in addresses[-1].split("."))
        answer = b"\xc0" + bytes([12 + len(question) + 12]) + struct.pack(">HHIH", 1, 1, 60, 4) + address
        return query[:2] + struct.pack(">5H", 0x8180, 1, 2, 0, 0) + question + alias + answer


class WlanStation:
    """WLAN interface of a board, with the behaviour of its port; `t` is in s and does not decrease.

    rp2: each `connect` restarts the join; after a loss nothing happens automatically, and the status stays at
    "joining". esp32: a `connect` during a join is refused; after a loss or failure the station retries
    automatically, a set number of times (-1: forever), and its status is the reason of the last failure.
    """

    def __init__(self, port: Literal["rp2", "esp32"], environment: WifiEnvironment) -> None:
        self.port, self.environment = port, environment
        self._codes = _STATUS_RP2 if port == "rp2" else _STATUS_ESP32
        self._max_retries, self._retries = -1, 0
        self._state, self._join_end = "off", 0.0
        self._first_activation = True

    @property
    def active(self) -> bool:
        """True if the interface is active."""
        return self._state != "off"

    def activate(self, on: bool, t: float) -> None:
        """Activate or deactivate the interface."""
        if not on:
            self._state = "off"
        elif self._state == "off":
            self._state = "idle"
            if self.environment.joining_at_power_on and self._first_activation:
                self._start_joining(t)
            self._first_activation = False

    def connect(self, t: float) -> int:
        """Start to join; return 0 or CONNECT_REFUSED."""
        self._update(t)
        if self._state == "off" or (self.port == "esp32" and self._is_joining):
            return CONNECT_REFUSED
        self._retries = 0
        self._start_joining(t)
        return 0

    def disconnect(self) -> None:
        """Leave the network, or cancel a join."""
        if self._state != "off":
            self._state = "idle"

    def set_reconnects(self, retries: int) -> None:
        """Set the number of automatic retries (esp32)."""
        self._max_retries = retries

    def status(self, t: float) -> int:
        """Return the status code of the port."""
        self._update(t)
        return self._codes[self._state]

    def is_connected(self, t: float) -> bool:
        """Return True if the station has joined."""
        self._update(t)
        return self._state == "up"

    @property
    def _is_joining(self) -> bool:
        """True while a connection is being established."""
        return self._join_end > 0.0

    def _start_joining(self, t: float) -> None:
        """Start a join at t."""
        self._state, self._join_end = "joining", t + self.environment.join_time

    def _update(self, t: float) -> None:
        """Update the state to t."""
        if self._state in ("off", "idle"):
            self._join_end = 0.0
        while self._join_end and t >= self._join_end:
            join_end, self._join_end = self._join_end, 0.0
            self._state = "up" if self.environment.is_reachable(join_end) else "no network"
            if self._state != "up":
                self._try_again(join_end)
        if self._state == "up" and not self.environment.is_reachable(t):
            self._state = "lost"
            self._try_again(t)

    def _try_again(self, t: float) -> None:
        """Start an automatic retry, if the port has one."""
        if self.port == "esp32" and (self._max_retries < 0 or self._retries < self._max_retries):
            self._retries += 1
            # The status stays at the reason of the last failure.
            self._join_end = t + self.environment.join_time
