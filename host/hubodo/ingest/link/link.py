"""One link with a thread of its own that opens, reads and reopens its port."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from hubodo.errors import LinkError
from hubodo.ingest.link.open_link import LinkDown, Transport
from hubodo.ingest.link.ports import DeviceFinder, DeviceLister, PortName, list_devices
from hubodo.ingest.link.retry import Backoff, ValidityCheck
from hubodo.ingest.link.transport import open_transport
from hubodo.ingest.link.writer import LinkWriter
from hubowire.budget import UART_BAUD

READ_TIMEOUT_S = 0.1
_REFUSAL_REPORT_INTERVAL_NS = 10_000_000_000


@dataclass(frozen=True, slots=True)
class LinkUp:
    """Report that the link is open; endpoint: name of the opened device or address."""

    link: str
    t_ns: int
    endpoint: str
    datagrams: bool


@dataclass(frozen=True, slots=True)
class LinkLost:
    """Report that the link was lost, or cannot be opened (reported once); `text`: the cause.

    unexpected: True for an exception that no driver should raise, False where the device is gone.
    """

    link: str
    t_ns: int
    text: str
    unexpected: bool = False


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes read together at host time `t_ns`; `sender`: peer address on a datagram port, else empty."""

    link: str
    t_ns: int
    data: bytes
    sender: str


@dataclass(frozen=True, slots=True)
class RefusedDatagrams:
    """Number of datagrams refused since the last report, by cause."""

    link: str
    t_ns: int
    refused: dict[str, int]


@dataclass(frozen=True, slots=True)
class TopicMessage:
    """A message of a ROS 2 topic, received at host time `t_ns`; wall_offset_ns: host minus wall clock."""

    link: str
    t_ns: int
    wall_offset_ns: int
    message_type: str
    payload: bytes


LinkReport = LinkUp | LinkLost | Chunk | RefusedDatagrams | TopicMessage


class Inbox(Protocol):
    """A queue to which links add their reports."""

    def put(self, item: LinkReport, /) -> None:
        """Add a report; from any thread."""
        ...


class PortLink:
    """A port that is read into a queue by a thread of its own until `stop` is called.

    A thread per link, because opening a device during enumeration, or connecting a socket, can block for
    seconds without delaying the other links; the arrival time is read directly after each read. An
    exception of a driver ends the attempt, never the thread: the link is opened again.
    """

    def __init__(
        self,
        port: PortName,
        label: str,
        reports: Inbox,
        now_ns: Callable[[], int],
        *,
        baud: int = UART_BAUD,
        lister: DeviceLister = list_devices,
    ) -> None:
        self.port = port
        self.label = label
        self._reports = reports
        self._now_ns = now_ns
        self._baud = baud
        self._finder = DeviceFinder(port, lister)
        self._transport_lock = (
            threading.Lock()
        )  # held while the transport is replaced, never during a read or write
        self._transport: Transport | None = None
        self._writer: LinkWriter | None = None
        self._check = ValidityCheck(0)
        self._next_refusal_report_ns = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"link {label}", daemon=True)

    def open_now(self) -> None:
        """Open the port in the caller's thread.

        Raises LinkError with a one-line reason.
        """
        try:
            self._open()
        except LinkError:
            raise
        except Exception as error:
            raise LinkError(f"{self.port.text}: cannot be opened: {_describe_error(error)}") from error

    def start(self) -> None:
        """Start the reading thread, which waits for a port that is not open yet."""
        self._thread.start()

    def send(self, data: bytes, to: str = "") -> bool:
        """Write at once; return False if the link is down or the write times out."""
        with self._transport_lock:
            writer = self._writer
        return writer is not None and writer.write(data, to)

    def request_stop(self) -> None:
        """Ask the thread to end, without waiting for it."""
        self._stopping.set()

    def stop(self, timeout_s: float = 2 * READ_TIMEOUT_S + 1) -> None:
        """End the thread, waiting up to `timeout_s` for it, and close the port."""
        self.request_stop()
        if self._thread.is_alive():
            self._thread.join(timeout_s)
        if self._thread.is_alive():  # closing the port may end a blocked read, but may block too
            threading.Thread(target=self._close, name=f"close {self.label}", daemon=True).start()
        else:
            self._close()

    def _open(self) -> None:
        transport = open_transport(self.port, self._finder, self._baud)
        with self._transport_lock:
            self._transport, self._writer = transport, LinkWriter(transport, self.label)
        self._check = ValidityCheck(self._now_ns())
        self._reports.put(LinkUp(self.label, self._now_ns(), transport.endpoint, transport.datagrams))

    def _close(self) -> None:
        with self._transport_lock:
            transport, self._transport = self._transport, None
            writer, self._writer = self._writer, None
        if writer is not None:
            writer.request_stop()
        if transport is None:
            return
        self._report_refused(transport)
        try:
            transport.close()
        except Exception as error:  # noqa: BLE001 the link is opened again in any case
            self._report_loss(f"cannot be closed: {_describe_error(error)}", unexpected=True)

    def _run(self) -> None:
        backoff = Backoff()
        while not self._stopping.is_set():
            self._stopping.wait(self._attempt(backoff))
        self._close()

    def _attempt(self, backoff: Backoff) -> float:
        """Open the link if necessary and read until it is lost; return the pause before reopening, s."""
        try:
            if self._transport is None:
                self._check = ValidityCheck(self._now_ns())
                self._open()
            self._read_until_stopped()
            return 0.0
        except LinkError as error:
            if backoff.is_first:
                self._report_loss(str(error))
            return backoff.pause_after_failed_open()
        except LinkDown as down:
            # Close before searching: while the old descriptor is open, the kernel gives the returning
            # device another name.
            self._close()
            self._report_loss(str(down))
        except Exception as error:  # noqa: BLE001 a driver may raise anything
            self._close()
            self._report_loss(f"unexpected error: {_describe_error(error)}", unexpected=True)
        return backoff.pause_after_loss(was_valid=self._check.is_valid(self._now_ns()))

    def _read_until_stopped(self) -> None:
        transport, writer = self._transport, self._writer
        while not self._stopping.is_set() and transport is not None and writer is not None:
            if writer.error is not None:
                raise writer.error
            data, sender = transport.read(READ_TIMEOUT_S)
            if transport.refused and self._now_ns() >= self._next_refusal_report_ns:
                self._report_refused(transport)
            if data:
                self._reports.put(Chunk(self.label, self._now_ns(), data, sender))
                self._check.feed(data)

    def _report_loss(self, text: str, *, unexpected: bool = False) -> None:
        self._reports.put(LinkLost(self.label, self._now_ns(), text, unexpected))

    def _report_refused(self, transport: Transport) -> None:
        if transport.refused:
            self._next_refusal_report_ns = self._now_ns() + _REFUSAL_REPORT_INTERVAL_NS
            self._reports.put(RefusedDatagrams(self.label, self._now_ns(), dict(transport.refused)))
            transport.refused.clear()


def _describe_error(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
