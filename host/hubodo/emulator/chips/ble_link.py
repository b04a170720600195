"""The air of Bluetooth Low Energy: connection events, air time, lost packets, in the time of the boards.

Bumble's controllers hand whole L2CAP packets to each other at once. Here they are cut into packets of the
link layer and exchanged in connection events, as in Bluetooth Core 5.4, Vol 6, Part B, 2.1 and 4.5.1: central
first, 150 us between packets, alternating until neither has data or the event of the next connection is due.
A lost packet ends the event, and both are sent again. Not modelled: channels, latency, encryption, collisions
of advertisements.
"""

from __future__ import annotations

import asyncio
import selectors
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random

from bumble import core, hci, ll
from bumble.controller import Controller
from bumble.link import LocalLink

_IFS_S = 150e-6
"""Space between two packets of a connection event."""
_GUARD_S = 150e-6
"""Space between the events of two connections."""
_BYTE_S = {1: 8e-6, 2: 4e-6}
"""Air time of a byte, by PHY."""
_LL_OVERHEAD_BYTES = {1: 10, 2: 11}
"""Preamble, access address, header and CRC, by PHY."""
MAX_PIECE_BYTES = 251
"""Payload of a packet of the link layer with the data length extension; without it 27."""


@dataclass(frozen=True)
class BleConditions:
    """Conditions of the air.

    Attributes
    ----------
    interval : s, connection interval of all connections.
    piece_bytes : payload of a packet of the link layer.
    phy : 1 or 2, Mb/s.
    loss : probability that a packet is lost.
    outages : intervals in s without reception.
    supervision_timeout : s without reception after which a connection is lost.
    slots : number of connections among which the central divides an interval.
    """

    interval: float = 0.030
    piece_bytes: int = MAX_PIECE_BYTES
    phy: int = 1
    loss: float = 0.0
    outages: tuple[tuple[float, float], ...] = ()
    supervision_timeout: float = 0.42
    slots: int = 2

    def air_time(self, size: int) -> float:
        """Return the duration of a packet of the link layer with `size` bytes, s."""
        return (_LL_OVERHEAD_BYTES[self.phy] + size) * _BYTE_S[self.phy]

    def is_out(self, t: float) -> bool:
        """Return True during an outage."""
        return any(start <= t < end for start, end in self.outages)


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """An event loop that never waits: its time, in s, is advanced by `run_until` alone."""

    def __init__(self) -> None:
        self.now = 0.0
        super().__init__(_AdvancingSelector(self))

    def time(self) -> float:
        return self.now

    def run_until(self, t: float) -> None:
        """Run all callbacks that are due up to t."""
        if t > self.now:
            self.call_at(t, self.stop)
        else:
            self.call_soon(self.stop)
        self.run_forever()
        self.now = max(self.now, t)


class _AdvancingSelector(selectors.SelectSelector):
    """A selector that advances the time of its loop instead of waiting."""

    def __init__(self, loop: VirtualTimeLoop) -> None:
        super().__init__()
        self._loop = loop

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is not None and timeout > 0:
            self._loop.now += timeout
        return []


class _Direction:
    """Packets of one side of a connection that wait for a connection event."""

    def __init__(self) -> None:
        self.pieces: deque[tuple[int, Callable[[], None] | None]] = deque()
        """(bytes, delivery of the L2CAP packet that ends with this piece)."""

    def add(self, size: int, piece_bytes: int, deliver: Callable[[], None]) -> None:
        """Add an L2CAP packet."""
        while size > piece_bytes:
            self.pieces.append((piece_bytes, None))
            size -= piece_bytes
        self.pieces.append((size, deliver))

    @property
    def next_bytes(self) -> int:
        """Size of the next piece; 0 for an empty packet."""
        return self.pieces[0][0] if self.pieces else 0


class _PacedConnection:
    """The connection events of a central and a peripheral; `down`, `up`: packets of either."""

    def __init__(self, link: PacedLink, central: Controller, peripheral: Controller, slot: int) -> None:
        self._link, self._central, self._peripheral = link, central, peripheral
        self.down, self.up = _Direction(), _Direction()
        self.closed = False
        loop = asyncio.get_running_loop()
        conditions = link.conditions
        self._anchor = loop.time() + conditions.interval * (1 + slot % conditions.slots / conditions.slots)
        self._received_at = loop.time()
        loop.call_at(self._anchor, self._run_event)

    def _run_event(self) -> None:
        """Exchange packets until the event ends; schedule the next event."""
        loop, link, conditions = asyncio.get_running_loop(), self._link, self._link.conditions
        if self.closed:
            return
        if not self._is_up():
            link.remove_connection(self, None)
            return
        used, available = 0.0, conditions.interval / conditions.slots - _GUARD_S
        while True:
            exchange = (
                conditions.air_time(self.down.next_bytes)
                + conditions.air_time(self.up.next_bytes)
                + 2 * _IFS_S
            )
            if used + exchange > available and used:
                break
            used += exchange
            if self._draw_loss(self._anchor + used):
                break
            self._received_at = self._anchor + used
            for direction in (self.down, self.up):
                if direction.pieces:
                    link.counts["pieces"] += 1
                    _, deliver = direction.pieces.popleft()
                    if deliver is not None:
                        loop.call_at(self._anchor + used, deliver)
            if not self.down.pieces and not self.up.pieces:
                break
        if self._anchor - self._received_at > conditions.supervision_timeout:
            link.remove_connection(self, hci.HCI_ErrorCode.CONNECTION_TIMEOUT_ERROR)
            return
        self._anchor += conditions.interval
        loop.call_at(self._anchor, self._run_event)

    def _is_up(self) -> bool:
        """Return True while one of both controllers has the connection."""
        central, peripheral = self._central, self._peripheral
        return (
            peripheral.random_address in central.le_connections
            or central.random_address in peripheral.le_connections
        )

    def _draw_loss(self, t: float) -> bool:
        """Return True if a packet of an exchange is lost, by chance or out of reach; count both."""
        link = self._link
        if {self._central, self._peripheral} - link.controllers or link.conditions.is_out(t):
            return True
        chance = 1 - (1 - link.conditions.loss) ** 2
        lost = link.random.random() < chance
        link.counts["exchanges"] += 1
        link.counts["exchanges lost"] += lost
        return lost

    def report_loss(self, reason: int) -> None:
        """Report the loss of the connection to both sides that still have it."""
        for one, other in ((self._central, self._peripheral), (self._peripheral, self._central)):
            connection = one.le_connections.get(other.random_address)
            if connection is not None:
                one.on_le_disconnected(connection, reason)


class PacedLink(LocalLink):
    """Bumble's link between controllers, with the timing and losses of `BleConditions`."""

    def __init__(self, conditions: BleConditions, random: Random) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.conditions, self.random = conditions, random
        self.counts: Counter[str] = Counter()
        self._connections: dict[frozenset[str], _PacedConnection] = {}
        self._slots = 0

    def send_acl_data(
        self,
        sender_controller: Controller,
        destination_address: hci.Address,
        transport: core.PhysicalTransport,
        data: bytes,
    ) -> None:
        receiver = self.find_le_controller(destination_address)
        connection = sender_controller.le_connections.get(destination_address)
        if receiver is None or connection is None:
            return
        is_central = connection.role == hci.Role.CENTRAL
        paced = (
            self._paced_connection(sender_controller, receiver)
            if is_central
            else self._paced_connection(receiver, sender_controller)
        )
        source = connection.self_address
        (paced.down if is_central else paced.up).add(
            len(data) + 4,
            self.conditions.piece_bytes,
            lambda: receiver.on_link_acl_data(source, transport, data),
        )

    def queued_pieces(self, peripheral: Controller) -> int:
        """Return the number of packets of the link layer that wait in a peripheral."""
        return sum(
            len(paced.up.pieces)
            for key, paced in self._connections.items()
            if str(peripheral.random_address) in key
        )

    def send_advertising_pdu(self, sender_controller: Controller, packet: ll.AdvertisingPdu) -> None:
        """Send an advertisement, and the response to a scan, which bumble's controllers do not send."""
        if self.conditions.is_out(asyncio.get_running_loop().time()):
            return
        super().send_advertising_pdu(sender_controller, packet)
        if isinstance(packet, ll.AdvExtInd):
            for one in sender_controller.advertising_sets.values():
                if one.scan_response_data:
                    response = replace(packet, data=bytes(one.scan_response_data))
                    super().send_advertising_pdu(sender_controller, response)

    def remove_connection(self, paced: _PacedConnection, reason: int | None) -> None:
        """Remove a connection; with a reason, both sides learn that it is lost."""
        paced.closed = True
        for key, value in list(self._connections.items()):
            if value is paced:
                del self._connections[key]
        if reason is not None:
            self.counts["connections lost"] += 1
            paced.report_loss(reason)

    def _paced_connection(self, central: Controller, peripheral: Controller) -> _PacedConnection:
        """Return the connection of both, which begins with its first packet."""
        key = frozenset({str(central.random_address), str(peripheral.random_address)})
        if key not in self._connections:
            self._connections[key] = _PacedConnection(self, central, peripheral, self._slots)
            self._slots += 1
        return self._connections[key]
