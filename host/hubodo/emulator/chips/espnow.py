"""ESP-NOW of an ESP32: peers, packets of up to 250 bytes, acknowledged by the MAC layer, a small buffer.

After ESP-IDF's esp_now.h and MicroPython's ports/esp32/modespnow.c: what is refused, and what is counted.
After IEEE 802.11 (2016), 10.3 and 15: 1 Mb/s with a long preamble, carrier sense, repeats.
Assumed: seven tries, a queue of six, everyone hears everyone. Not modelled: encryption, other traffic.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from enum import IntEnum
from random import Random
from typing import Protocol

from hubodo.emulator.chips.nrf24 import LATE_NS, TWICE_NS, Weather

BROADCAST = b"\xff" * 6
MOST, PEERS, HEAD = 250, 20, 13
NOT_INIT, ARG, NO_MEM, FULL, NOT_FOUND, EXIST = 1, 2, 3, 4, 5, 7
"""Refusals: the numbers behind ESP_ERR_ESPNOW_BASE."""

_TRIES, _QUEUE = 7, 6
_PREAMBLE_NS, _BYTE_NS, _WRAPPING = 192e3, 8e3, 43
_DIFS_NS, _SLOT_NS, _SLOTS, _ACK_NS = 50e3, 20e3, 32, 314e3
_RSSI_DBM = -50


class What(IntEnum):
    """What a call asks for: the first byte of what goes out."""

    ACTIVE = 0
    PEER = 1
    NO_PEER = 2
    SEND = 3
    RECEIVE = 4
    STATS = 5


class SharedMedium(Protocol):
    """See `board.ether.Ether`."""

    weather: Weather
    random: Random
    stations: list[EspNow]
    busy_until: float

    def later(self, t: float, what: Callable[[float], None]) -> None: ...

    def lost(self, kind: str) -> bool: ...


class EspNow:
    """One station, known by its MAC; times in ns."""

    def __init__(self, air: SharedMedium, mac: bytes) -> None:
        self._air, self.mac = air, mac
        self.silent = False
        self.reset()
        air.stations.append(self)

    def reset(self) -> None:
        """The processor restarts: nothing is known, nothing waits."""
        self._room = 0
        self._peers: set[bytes] = set()
        self._waiting: deque[tuple[bytes, bytes]] = deque()
        self._came: deque[bytes] = deque()
        self._sent = self._answered = self._failed = self._heard = self._dropped = 0
        self._life = object()
        """What is on the air from an earlier life has nobody to come back to."""

    def call(self, t: float, request: bytes) -> tuple[int, bytes]:
        """(status or minus a refusal, what was asked for)."""
        what, data = request[0], request[1:]
        if what == What.ACTIVE:
            on, self._room = struct.unpack("<HH", data)
            self._room = self._room + 7 if on else 0
            return 0, b""
        if what == What.STATS:
            return 20, struct.pack(
                "<5I", self._sent, self._answered, self._failed, self._heard, self._dropped
            )
        if not self._room:
            return -NOT_INIT, b""
        if what == What.PEER:
            return self._add(data[:6]), b""
        if what == What.NO_PEER:
            known = data[:6] in self._peers
            self._peers.discard(data[:6])
            return 0 if known else -NOT_FOUND, b""
        if what == What.SEND:
            return self._queue(t, data[:6], data[6:]), b""
        if what == What.RECEIVE:
            packet = self._came.popleft() if self._came else b""
            return len(packet), packet
        return -ARG, b""

    def _add(self, mac: bytes) -> int:
        if mac in self._peers:
            return -EXIST
        if len(self._peers) >= PEERS:
            return -FULL
        self._peers.add(mac)
        return 0

    def _queue(self, t: float, mac: bytes, data: bytes) -> int:
        if not 0 < len(data) <= MOST:
            return -ARG
        if mac not in self._peers:
            return -NOT_FOUND
        if len(self._waiting) >= _QUEUE:
            return -NO_MEM
        self._sent += 1
        self._waiting.append((mac, data))
        if len(self._waiting) == 1:
            self._send(t, 1, heard=False)
        return 0

    def _send(self, t: float, tries: int, *, heard: bool) -> None:
        """The first that waits goes as soon as the air is free. heard: it has come, its answer has not."""
        air, (_, data) = self._air, self._waiting[0]
        begin = max(t, air.busy_until) + _DIFS_NS + air.random.randrange(_SLOTS) * _SLOT_NS
        end = air.busy_until = begin + _PREAMBLE_NS + (_WRAPPING + len(data)) * _BYTE_NS
        life = self._life
        air.later(end, lambda now: self._over(now, tries, life, heard=heard))

    def _over(self, t: float, tries: int, life: object, *, heard: bool) -> None:
        if self.silent or life is not self._life:
            return
        air, (mac, data) = self._air, self._waiting[0]
        lost = air.lost("packets")
        if mac == BROADCAST:
            for other in air.stations:
                if other is not self and not lost:
                    other.hear(t, self.mac, data)
            self._done(t, ok=True)
            return
        there = [other for other in air.stations if other.mac == mac and other.listens]
        if there and not lost:
            if not heard:
                there[0].hear(t, self.mac, data)
            heard = True
            air.busy_until = max(air.busy_until, t + _ACK_NS)
            if not air.lost("answers"):
                self._done(t + _ACK_NS, ok=True)
                return
        if tries < _TRIES:
            self._send(t + _ACK_NS, tries + 1, heard=heard)
        else:
            self._done(t + _ACK_NS, ok=False)

    def _done(self, t: float, *, ok: bool) -> None:
        self._waiting.popleft()
        self._answered += 1
        self._failed += not ok
        if self._waiting:
            self._send(t, 1, heard=False)

    @property
    def listens(self) -> bool:
        """Whether it acknowledges what is sent to it; the MAC layer does, whatever the buffer holds."""
        return bool(self._room) and not self.silent

    def hear(self, t: float, sender: bytes, data: bytes) -> None:
        """A packet that has come through the air."""
        weather, draw = self._air.weather, self._air.random.random
        if draw() < weather.late:
            self._air.later(t + LATE_NS, lambda now: self._store(sender, data))
            return
        self._store(sender, data)
        if draw() < weather.twice:
            self._air.later(t + TWICE_NS, lambda now: self._store(sender, data))

    def _store(self, sender: bytes, data: bytes) -> None:
        if not self.listens:
            return
        used = sum(len(packet) + HEAD - 7 for packet in self._came)
        if HEAD + len(data) >= self._room - used:
            self._dropped += 1
            return
        self._heard += 1
        self._came.append(sender + bytes([_RSSI_DBM & 0xFF]) + data)
