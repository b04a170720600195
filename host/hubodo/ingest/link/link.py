"""One link kept alive by its own thread: opens, reads, survives unplugging, finds the device again."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from hubodo.errors import LinkError
from hubodo.ingest.link.down import LinkDown, Transport
from hubodo.ingest.link.ports import Finder, Lister, PortName, list_devices
from hubodo.ingest.link.transport import open_transport
from hubowire.budget import UART_BAUD

READ_S = 0.1
_TELL_NS = 10_000_000_000
_BACKOFF_S = (0.05, 0.05, 0.1, 0.1, 0.2, 0.5, 1.0)


@dataclass(frozen=True, slots=True)
class LinkUp:
    """The link is open; `where` is the device's name of today."""

    link: str
    t_ns: int
    where: str
    datagrams: bool


@dataclass(frozen=True, slots=True)
class LinkLost:
    """The link has gone, or cannot be opened at the start (said once); `text` says how."""

    link: str
    t_ns: int
    text: str


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes that arrived together at host time `t_ns`; `sender` tells the peers of a datagram port apart."""

    link: str
    t_ns: int
    data: bytes
    sender: str


@dataclass(frozen=True, slots=True)
class Intruders:
    """Datagrams came that were not let in: how many by cause, since this was last told."""

    link: str
    t_ns: int
    refused: dict[str, int]


LinkNews = LinkUp | LinkLost | Chunk | Intruders


class Inbox(Protocol):
    """Where links put their news."""

    def put(self, item: LinkNews, /) -> None: ...


class PortLink:
    """Reads one port into a queue from a thread of its own, until `stop`.

    A thread, because opening a device that is being enumerated, or connecting a socket, can block for
    seconds, which must not hold up the other links; the time of arrival is taken right behind the read.
    """

    def __init__(
        self,
        port: PortName,
        label: str,
        news: Inbox,
        now_ns: Callable[[], int],
        *,
        baud: int = UART_BAUD,
        lister: Lister = list_devices,
    ) -> None:
        self.port = port
        self.label = label
        self._news = news
        self._now_ns = now_ns
        self._baud = baud
        self._finder = Finder(port, lister)
        self._transport: Transport | None = None
        self._open = threading.Lock()  # held while the transport is written to or replaced
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"link {label}", daemon=True)

    def open_now(self) -> None:
        """First attempt, in the caller's thread.

        Raises LinkError with the reason, in one line.
        """
        self._adopt(open_transport(self.port, self._finder, self._baud))

    def start(self) -> None:
        """Starts reading; a link that is not open yet is waited for."""
        self._thread.start()

    def send(self, data: bytes, to: str = "") -> bool:
        """Writes at once; False when the link is down or takes nothing within 0.1 s."""
        with self._open:
            transport = self._transport
            if transport is None:
                return False
            try:
                transport.write(data, to)
            except LinkDown:
                return False  # the reader meets the same end and reports it
            return True

    def end(self) -> None:
        """Tells the thread to end, without waiting for it."""
        self._stopping.set()

    def stop(self, patience_s: float = 2 * READ_S + 1) -> None:
        """Ends the thread and closes the port; a thread that hangs in it is waited for that long."""
        self.end()
        if self._thread.is_alive():
            self._thread.join(patience_s)
        self._close()

    def _adopt(self, transport: Transport) -> None:
        with self._open:
            self._transport = transport
        self._news.put(LinkUp(self.label, self._now_ns(), transport.where, transport.datagrams))

    def _close(self) -> None:
        with self._open:
            transport, self._transport = self._transport, None
            if transport is not None:
                transport.close()

    def _run(self) -> None:
        failures = told_ns = 0
        while not self._stopping.is_set():
            transport = self._transport
            if transport is None:
                try:
                    self._adopt(open_transport(self.port, self._finder, self._baud))
                    failures = 0
                except LinkError as error:
                    if failures == 0:
                        self._news.put(LinkLost(self.label, self._now_ns(), str(error)))
                    self._stopping.wait(_BACKOFF_S[min(failures, len(_BACKOFF_S) - 1)])
                    failures += 1
                continue
            try:
                data, sender = transport.read(READ_S)
            except LinkDown as down:
                # Closed before it is looked for: while the old descriptor lives, the kernel gives the
                # device that comes back another name.
                self._close()
                self._news.put(LinkLost(self.label, self._now_ns(), str(down)))
                failures = 1
                self._stopping.wait(_BACKOFF_S[0])
                continue
            if self._now_ns() >= told_ns and self._tell_refused(transport):
                told_ns = self._now_ns() + _TELL_NS
            if data:
                self._news.put(Chunk(self.label, self._now_ns(), data, sender))
        if self._transport is not None:
            self._tell_refused(self._transport)

    def _tell_refused(self, transport: Transport) -> bool:
        """Whether there was something to tell."""
        if not transport.refused:
            return False
        self._news.put(Intruders(self.label, self._now_ns(), dict(transport.refused)))
        transport.refused.clear()
        return True
