"""Emulated ESP-NOW of an ESP32: peers, acknowledged packets of up to 250 bytes, and a small receive buffer.

Refusals and counters follow esp_now.h of ESP-IDF and ports/esp32/modespnow.c of MicroPython. Air time,
carrier sense and retries follow IEEE 802.11 (2016), 10.3 and 15: 1 Mb/s with a long preamble. Assumed: seven
attempts, a queue of six packets, and every station receives every other. Not modelled: encryption, other
traffic.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from enum import IntEnum
from random import Random
from typing import Protocol

from hubodo.emulator.chips.nrf24 import DUPLICATE_DELAY_NS, LATE_DELAY_NS, PacketFaults

BROADCAST = b"\xff" * 6
MAX_PACKET_BYTES, MAX_PEERS, BUFFER_HEADER_BYTES = 250, 20, 13
NOT_INIT, ARG, NO_MEM, FULL, NOT_FOUND, EXIST = 1, 2, 3, 4, 5, 7
"""Errors, as offsets from ESP_ERR_ESPNOW_BASE."""

_MAX_ATTEMPTS, _SEND_QUEUE_PACKETS = 7, 6
_PREAMBLE_NS, _BYTE_NS, _OVERHEAD_BYTES_80211 = 192e3, 8e3, 43
_DIFS_NS, _SLOT_NS, _SLOTS, _ACK_NS = 50e3, 20e3, 32, 314e3
_RSSI_DBM = -50


class EspNowCall(IntEnum):
    """Calls of the firmware; the first byte of a request."""

    ACTIVE = 0
    ADD_PEER = 1
    REMOVE_PEER = 2
    SEND = 3
    RECEIVE = 4
    STATS = 5


class StationMedium(Protocol):
    """Part of `board.radio_medium.RadioMedium` that a station uses."""

    packet_faults: PacketFaults
    random: Random
    stations: list[EspNow]
    busy_until: float

    def schedule(self, t: float, call: Callable[[float], None]) -> None: ...

    def draw_loss(self, kind: str) -> bool: ...


class EspNow:
    """An ESP-NOW station with its MAC address; times are in ns."""

    def __init__(self, medium: StationMedium, mac: bytes) -> None:
        self._medium, self.mac = medium, mac
        self.switched_off = False
        self.reset()
        medium.stations.append(self)

    def reset(self) -> None:
        """Clear peers, queues and counters, as at a restart of the processor."""
        self._buffer_bytes = 0
        self._peers: set[bytes] = set()
        self._send_queue: deque[tuple[bytes, bytes]] = deque()
        self._receive_queue: deque[bytes] = deque()
        self._sent_count = self._reply_count = self._failed_count = self._received_count = (
            self._dropped_count
        ) = 0
        self._session = object()
        """Token of this session; transmissions of an earlier session are ignored."""

    def handle_call(self, t: float, request: bytes) -> tuple[int, bytes]:
        """Handle a call of the firmware; return a status, negative for a refusal, and the result."""
        call, data = request[0], request[1:]
        if call == EspNowCall.ACTIVE:
            on, self._buffer_bytes = struct.unpack("<HH", data)
            self._buffer_bytes = self._buffer_bytes + 7 if on else 0
            return 0, b""
        if call == EspNowCall.STATS:
            return 20, struct.pack(
                "<5I",
                self._sent_count,
                self._reply_count,
                self._failed_count,
                self._received_count,
                self._dropped_count,
            )
        if not self._buffer_bytes:
            return -NOT_INIT, b""
        if call == EspNowCall.ADD_PEER:
            return self._add_peer(data[:6]), b""
        if call == EspNowCall.REMOVE_PEER:
            is_known = data[:6] in self._peers
            self._peers.discard(data[:6])
            return 0 if is_known else -NOT_FOUND, b""
        if call == EspNowCall.SEND:
            return self._queue(t, data[:6], data[6:]), b""
        if call == EspNowCall.RECEIVE:
            packet = self._receive_queue.popleft() if self._receive_queue else b""
            return len(packet), packet
        return -ARG, b""

    def _add_peer(self, mac: bytes) -> int:
        """Add a peer and return the status."""
        if mac in self._peers:
            return -EXIST
        if len(self._peers) >= MAX_PEERS:
            return -FULL
        self._peers.add(mac)
        return 0

    def _queue(self, t: float, mac: bytes, data: bytes) -> int:
        """Queue a packet for sending and return the status."""
        if not 0 < len(data) <= MAX_PACKET_BYTES:
            return -ARG
        if mac not in self._peers:
            return -NOT_FOUND
        if len(self._send_queue) >= _SEND_QUEUE_PACKETS:
            return -NO_MEM
        self._sent_count += 1
        self._send_queue.append((mac, data))
        if len(self._send_queue) == 1:
            self._send(t, 1, delivered=False)
        return 0

    def _send(self, t: float, attempt: int, *, delivered: bool) -> None:
        """Send the first queued packet when the medium is free.

        delivered: True if the peer received it before, but the acknowledgement was lost.
        """
        medium, (_, data) = self._medium, self._send_queue[0]
        start_ns = max(t, medium.busy_until) + _DIFS_NS + medium.random.randrange(_SLOTS) * _SLOT_NS
        end_ns = medium.busy_until = start_ns + _PREAMBLE_NS + (_OVERHEAD_BYTES_80211 + len(data)) * _BYTE_NS
        session = self._session
        medium.schedule(end_ns, lambda now: self._end_packet(now, attempt, session, delivered=delivered))

    def _end_packet(self, t: float, attempt: int, session: object, *, delivered: bool) -> None:
        """Finish a transmission: deliver it, and acknowledge or retry it."""
        if self.switched_off or session is not self._session:
            return
        medium, (mac, data) = self._medium, self._send_queue[0]
        lost = medium.draw_loss("packets")
        if mac == BROADCAST:
            for other in medium.stations:
                if other is not self and not lost:
                    other.receive(t, self.mac, data)
            self._complete_packet(t, ok=True)
            return
        receivers = [other for other in medium.stations if other.mac == mac and other.is_listening]
        if receivers and not lost:
            if not delivered:
                receivers[0].receive(t, self.mac, data)
            delivered = True
            medium.busy_until = max(medium.busy_until, t + _ACK_NS)
            if not medium.draw_loss("answers"):
                self._complete_packet(t + _ACK_NS, ok=True)
                return
        if attempt < _MAX_ATTEMPTS:
            self._send(t + _ACK_NS, attempt + 1, delivered=delivered)
        else:
            self._complete_packet(t + _ACK_NS, ok=False)

    def _complete_packet(self, t: float, *, ok: bool) -> None:
        """Remove the packet that was sent or given up, and send the next one."""
        self._send_queue.popleft()
        self._reply_count += 1
        self._failed_count += not ok
        if self._send_queue:
            self._send(t, 1, delivered=False)

    @property
    def is_listening(self) -> bool:
        """True if the station acknowledges packets; its MAC layer does so even with a full buffer."""
        return bool(self._buffer_bytes) and not self.switched_off

    def receive(self, t: float, sender: bytes, data: bytes) -> None:
        """Receive a packet from the medium."""
        packet_faults, draw_random = self._medium.packet_faults, self._medium.random.random
        if draw_random() < packet_faults.delay:
            self._medium.schedule(t + LATE_DELAY_NS, lambda now: self._store(sender, data))
            return
        self._store(sender, data)
        if draw_random() < packet_faults.duplication:
            self._medium.schedule(t + DUPLICATE_DELAY_NS, lambda now: self._store(sender, data))

    def _store(self, sender: bytes, data: bytes) -> None:
        """Store a received packet, or drop it if the buffer is full."""
        if not self.is_listening:
            return
        used = sum(len(packet) + BUFFER_HEADER_BYTES - 7 for packet in self._receive_queue)
        if BUFFER_HEADER_BYTES + len(data) >= self._buffer_bytes - used:
            self._dropped_count += 1
            return
        self._received_count += 1
        self._receive_queue.append(sender + bytes([_RSSI_DBM & 0xFF]) + data)
