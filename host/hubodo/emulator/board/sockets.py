"""Network calls of a board: the WLAN interface, and UDP sockets on those of the host."""

from __future__ import annotations

import select
import socket
import struct
from collections import Counter

from hubodo.emulator.board.clock import FOREVER, BoardClock
from hubodo.emulator.board.hypercall import (
    EAGAIN,
    EHOSTUNREACH,
    EINVAL,
    ETIMEDOUT,
    Deferred,
    Handler,
    Op,
    Reply,
)
from hubodo.emulator.board.models import BoardModel
from hubodo.emulator.board.network import MULTICAST, NAME_SERVER, WifiEnvironment, WlanStation
from hubodo.units import NS_PER_S

WLAN_JOIN_NS = 50_000_000
"""Time for which a join blocks the processor; an assumption, above that of either port."""


class BoardNetwork:
    """WLAN station and sockets of one board; cleared when the processor restarts."""

    def __init__(
        self, model: BoardModel, air: WifiEnvironment, clock: BoardClock, counts: Counter[str]
    ) -> None:
        self._model, self._air, self._clock, self._counts = model, air, clock, counts
        self.station = WlanStation(model.platform, air)
        self._sockets: dict[int, socket.socket] = {}
        self._dns_replies: dict[int, list[tuple[tuple[str, int], bytes]]] = {}
        """Replies of the DNS server, by socket handle."""

    def reset(self) -> None:
        """Close all sockets and switch the station off, as at a restart of the processor."""
        for handle in list(self._sockets):
            self._sockets.pop(handle).close()
        self._dns_replies.clear()
        self.station = WlanStation(self._model.platform, self._air)

    def is_radio_on(self) -> bool:
        """Return True if the WLAN interface is active."""
        return self.station.active

    def handlers(self) -> dict[int, Handler]:
        """Return the handlers of the calls served here."""
        return {
            Op.WLAN: self._wlan,
            Op.UDP_OPEN: self._open,
            Op.UDP_BIND: self._bind,
            Op.UDP_SEND: self._send,
            Op.UDP_RECV: self._receive,
            Op.UDP_CLOSE: self._close,
        }

    def has_datagram(self, handle: int) -> bool:
        """Return True if a datagram is available at a socket."""
        sock = self._sockets.get(handle)
        return bool(self._dns_replies.get(handle)) or (
            sock is not None and bool(select.select([sock], [], [], 0)[0])
        )

    def _wlan(self, argument: int, payload: bytes, t: float) -> Reply:
        station, seconds = self.station, t / NS_PER_S
        status = 0
        if argument < 2:
            station.activate(argument == 1, seconds)
        elif argument == 2:
            status = station.connect(seconds)
            t += WLAN_JOIN_NS
        elif argument == 3:
            station.disconnect()
        elif argument == 4:
            status = station.status(seconds)
        elif argument == 5:
            status = int(station.is_connected(seconds))
        else:
            station.set_reconnects((argument & 0xFF) - 1)
        return Reply(t, status)

    def _open(self, argument: int, payload: bytes, t: float) -> Reply:
        handle = next(it for it in range(1, 256) if it not in self._sockets)
        self._sockets[handle] = sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setblocking(False)
        return Reply(t, handle)

    def _bind(self, argument: int, payload: bytes, t: float) -> Reply:
        try:
            self._sockets[argument].bind(("127.0.0.1", struct.unpack("<H", payload)[0]))
        except OSError:
            return Reply(t, -EINVAL)
        return Reply(t)

    def _send(self, argument: int, payload: bytes, t: float) -> Reply:
        host, (port,) = socket.inet_ntoa(payload[:4]), struct.unpack_from("<H", payload, 4)
        if not self.station.is_connected(t / NS_PER_S):
            return Reply(t, -EHOSTUNREACH)
        if (host, port) in (NAME_SERVER, MULTICAST):
            reply = self._air.answer_dns(t / NS_PER_S, payload[6:])
            if reply is not None:
                self._dns_replies.setdefault(argument, []).append(((host, port), reply))
            return Reply(t, len(payload) - 6)
        try:
            size = self._sockets[argument].sendto(payload[6:], (host, port))
        except BlockingIOError:
            return Reply(t, -EAGAIN)
        except OSError:
            # A datagram without receiver is lost, not refused.
            self._counts["udp_lost"] += 1
            return Reply(t, len(payload) - 6)
        self._counts["bytes_out"] += size
        return Reply(t, size)

    def _receive(self, argument: int, payload: bytes, t: float) -> Deferred:
        limit, wait_ms = struct.unpack("<Ii", payload)
        sock = self._sockets[argument]

        def poll_reply(is_late: bool) -> Reply | None:
            try:
                if self._dns_replies.get(argument):
                    (host, port), data = self._dns_replies[argument].pop(0)
                else:
                    data, (host, port) = sock.recvfrom(limit)
            except (BlockingIOError, ConnectionError):
                if not (is_late or wait_ms == 0):
                    return None
                return Reply(self._clock.now(), -EAGAIN if wait_ms == 0 else -ETIMEDOUT)
            self._counts["bytes_in"] += len(data)
            sender = socket.inet_aton(host) + struct.pack("<H", port)
            return Reply(self._clock.now(), len(data), sender + data)

        return Deferred(FOREVER if wait_ms < 0 else wait_ms * 1e6, poll_reply)

    def _close(self, argument: int, payload: bytes, t: float) -> Reply:
        self._dns_replies.pop(argument, None)
        if argument in self._sockets:
            self._sockets.pop(argument).close()
        return Reply(t)
