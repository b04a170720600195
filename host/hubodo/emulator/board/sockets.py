"""What the board's network does at a call: the WLAN interface and UDP sockets, on those of the machine."""

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
from hubodo.emulator.board.network import MULTICAST, NAME_SERVER, Air, WlanStation
from hubodo.units import NS_PER_S

JOIN_NS = 50_000_000
"""What the radio's commands of a join hold the processor up: assumed, dearer than on either port."""


class Network:
    """Of one board, from a start of its processor to the next."""

    def __init__(self, model: BoardModel, air: Air, clock: BoardClock, counts: Counter[str]) -> None:
        self._model, self._air, self._clock, self._counts = model, air, clock, counts
        self.station = WlanStation(model.platform, air)
        self._sockets: dict[int, socket.socket] = {}
        self._mail: dict[int, list[tuple[tuple[str, int], bytes]]] = {}
        """What the air itself has answered to a socket."""

    def reset(self) -> None:
        """The processor restarts: nothing is open, the station is off."""
        for handle in list(self._sockets):
            self._sockets.pop(handle).close()
        self._mail.clear()
        self.station = WlanStation(self._model.platform, self._air)

    def radio_on(self) -> bool:
        """Whether the WLAN interface is switched on."""
        return self.station.active

    def handlers(self) -> dict[int, Handler]:
        """What each call does here."""
        return {
            Op.WLAN: self._wlan,
            Op.UDP_OPEN: self._open,
            Op.UDP_BIND: self._bind,
            Op.UDP_SEND: self._send,
            Op.UDP_RECV: self._receive,
            Op.UDP_CLOSE: self._close,
        }

    def waits(self, handle: int) -> bool:
        """Whether a datagram waits for a socket."""
        sock = self._sockets.get(handle)
        return bool(self._mail.get(handle)) or (
            sock is not None and bool(select.select([sock], [], [], 0)[0])
        )

    def _wlan(self, a: int, payload: bytes, t: float) -> Reply:
        station, seconds = self.station, t / NS_PER_S
        status = 0
        if a < 2:
            station.activate(a == 1, seconds)
        elif a == 2:
            status = station.connect(seconds)
            t += JOIN_NS
        elif a == 3:
            station.disconnect()
        elif a == 4:
            status = station.status(seconds)
        elif a == 5:
            status = int(station.up(seconds))
        else:
            station.reconnects((a & 0xFF) - 1)
        return Reply(t, status)

    def _open(self, a: int, payload: bytes, t: float) -> Reply:
        handle = next(k for k in range(1, 256) if k not in self._sockets)
        self._sockets[handle] = sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setblocking(False)
        return Reply(t, handle)

    def _bind(self, a: int, payload: bytes, t: float) -> Reply:
        try:
            self._sockets[a].bind(("127.0.0.1", struct.unpack("<H", payload)[0]))
        except OSError:
            return Reply(t, -EINVAL)
        return Reply(t)

    def _send(self, a: int, payload: bytes, t: float) -> Reply:
        host, (port,) = socket.inet_ntoa(payload[:4]), struct.unpack_from("<H", payload, 4)
        if not self.station.up(t / NS_PER_S):
            return Reply(t, -EHOSTUNREACH)
        if (host, port) in (NAME_SERVER, MULTICAST):
            reply = self._air.reply(t / NS_PER_S, payload[6:])
            if reply is not None:
                self._mail.setdefault(a, []).append(((host, port), reply))
            return Reply(t, len(payload) - 6)
        try:
            n = self._sockets[a].sendto(payload[6:], (host, port))
        except BlockingIOError:
            return Reply(t, -EAGAIN)
        except OSError:
            # A datagram to nobody is lost in the air, not refused.
            self._counts["udp_lost"] += 1
            return Reply(t, len(payload) - 6)
        self._counts["bytes_out"] += n
        return Reply(t, n)

    def _receive(self, a: int, payload: bytes, t: float) -> Deferred:
        most, wait_ms = struct.unpack("<Ii", payload)
        sock = self._sockets[a]

        def finished(late: bool) -> Reply | None:
            try:
                if self._mail.get(a):
                    (host, port), data = self._mail[a].pop(0)
                else:
                    data, (host, port) = sock.recvfrom(most)
            except (BlockingIOError, ConnectionError):
                if not (late or wait_ms == 0):
                    return None
                return Reply(self._clock.now(), -EAGAIN if wait_ms == 0 else -ETIMEDOUT)
            self._counts["bytes_in"] += len(data)
            sender = socket.inet_aton(host) + struct.pack("<H", port)
            return Reply(self._clock.now(), len(data), sender + data)

        return Deferred(FOREVER if wait_ms < 0 else wait_ms * 1e6, finished)

    def _close(self, a: int, payload: bytes, t: float) -> Reply:
        self._mail.pop(a, None)
        if a in self._sockets:
            self._sockets.pop(a).close()
        return Reply(t)
