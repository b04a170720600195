"""A computer in virtual time, whose clock advances with its devices while the recorder waits for reports.

Delays of the real computer affect wall-clock time only: in virtual time nothing is late.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

from hubodo.errors import LinkError
from hubodo.ingest.link.link import Chunk, LinkLost, LinkUp
from hubodo.ingest.link.open_link import LinkDown, Transport
from hubodo.ingest.link.ports import DeviceFinder, DeviceLister, PortName
from hubodo.ingest.link.transport import open_transport
from hubodo.ingest.live.host_clock import ClockState
from hubodo.units import NS_PER_S

_TIME_STEP_NS = NS_PER_S // 100
_RETRY_INTERVAL_NS = NS_PER_S // 20
_START_NS = 1_790_000_000 * NS_PER_S  # in September 2026; the same in each run, so that a run can be repeated
_TERMINAL_TIMEOUT_S = 20.0
"""Real time for bytes written on one side of a terminal to become readable on the other."""

SentBytes = list[tuple[int, int]]
"""(time ns, number of bytes) of each write of a device to its port, in order."""


class Device(Protocol):
    """A device on a serial port in virtual time; path: the terminal that it uses at present."""

    path: str

    def advance_to(self, t_ns: int, sent_count: int | None) -> None:
        """Start to advance to `t_ns`.

        sent_count: number of bytes that the host has sent since the last call; None if the port is closed.
        """
        ...

    def wait_for_writes(self) -> SentBytes:
        """Wait for the advance to end and return the writes to a port that is open."""
        ...


class VirtualComputer:
    """A `Computer` in virtual time with devices on its serial ports."""

    def __init__(
        self,
        on_step: Callable[[int], None] = lambda t_ns: None,
        *,
        start_ns: int = _START_NS,
        folder: Path | None = None,
    ) -> None:
        """Start without devices.

        on_step: called with the virtual time, ns, after each step. start_ns: initial time. folder: devices in
        it are logged by file name only, so that no path of this computer is logged.
        """
        self._now_ns = start_ns
        self._on_step = on_step
        self._folder = folder
        self._devices: list[Device] = []
        self._resolved_paths: dict[str, tuple[str, str]] = {}
        self._links: list[VirtualLink] = []
        self._reports: deque[Any] = deque()

    def plug_in(self, device: Device) -> None:
        """Add a device; devices advance in the order of addition."""
        self._devices.append(device)

    def now_ns(self) -> int:
        """Return host time, ns since 1970; it never steps."""
        return self._now_ns

    def wall_ns(self) -> int:
        """Return the wall clock, ns since 1970; it steps when it is set."""
        return self.now_ns()

    def clock_state(self) -> ClockState:
        """Return the synchronisation state of the wall clock."""
        return ClockState.UNKNOWN

    def device_name(self, endpoint: str) -> str:
        """Return the name of a device in the log."""
        path = Path(endpoint)
        return path.name if self._folder is not None and path.parent == self._folder else endpoint

    def put(self, item: Any) -> None:
        """Append an item to the queue of `next_report`; from any thread."""
        self._reports.append(item)

    def create_link(self, port: PortName, label: str, baud: int, lister: DeviceLister) -> VirtualLink:
        """Return a link on a port, not opened or started."""
        link = VirtualLink(port, label, self, baud, lister)
        self._links.append(link)
        return link

    def next_report(self, timeout_s: float) -> Any:
        """Return the next item, waiting up to `timeout_s` for it; None if there was none."""
        end_ns = self._now_ns + int(timeout_s * NS_PER_S)
        while not self._reports and self._now_ns < end_ns:
            self._step(min(self._now_ns + _TIME_STEP_NS, end_ns))
        return self._reports.popleft() if self._reports else None

    def _step(self, t_ns: int) -> None:
        links = {link.device_path: link for link in self._links if link.device_path}
        for device in self._devices:
            link = links.get(self._resolve(device.path))
            device.advance_to(t_ns, None if link is None else link.take_sent_count())
        sent = [(links.get(self._resolve(device.path)), device.wait_for_writes()) for device in self._devices]
        self._now_ns = t_ns
        chunks = [chunk for link, counts in sent if link is not None for chunk in link.read(counts)]
        for chunk in sorted(chunks, key=lambda chunk: chunk.t_ns):
            self.put(chunk)
        for link in self._links:
            link.poll()
        self._on_step(t_ns)

    def _resolve(self, path: str) -> str:
        """Return the real path of a symlink; it is resolved again only after the symlink has changed."""
        try:
            target = os.readlink(path)  # noqa: PTH115  thousands of times in a recording
        except OSError:
            target = ""
        known, real = self._resolved_paths.get(path, (None, ""))
        if known != target:
            real = os.path.realpath(path)
            self._resolved_paths[path] = target, real
        return real


class VirtualLink:
    """A link on a real port like `PortLink`, but read in the steps of the virtual computer."""

    def __init__(
        self, port: PortName, label: str, computer: VirtualComputer, baud: int, lister: DeviceLister
    ) -> None:
        self.device_path = ""
        """Real path of the open device; empty while closed."""
        self._written = 0
        self._port, self._label, self._computer, self._baud = port, label, computer, baud
        self._finder = DeviceFinder(port, lister)
        self._transport: Transport | None = None
        self._is_started = self._loss_reported = False
        self._retry_ns = 0

    def open_now(self) -> None:
        """Open the port; raise LinkError with a one-line reason."""
        self._transport = open_transport(self._port, self._finder, self._baud)
        self.device_path, self._written, self._loss_reported = (
            os.path.realpath(self._transport.endpoint),
            0,
            False,
        )
        endpoint = self._computer.device_name(self._transport.endpoint)
        self._computer.put(LinkUp(self._label, self._computer.now_ns(), endpoint, self._transport.datagrams))

    def start(self) -> None:
        """Start reading; a port that is not open yet is waited for."""
        self._is_started = True

    def send(self, data: bytes, to: str = "") -> bool:
        """Send bytes to the peer `to`; return True on success."""
        if self._transport is None:
            return False
        try:
            self._transport.write(data, to)
        except LinkDown:
            return False  # the next poll gets the same error and reports it
        self._written += len(data)
        return True

    def request_stop(self) -> None:
        """Request the end of reading, without waiting."""

    def stop(self, timeout_s: float = 0.0) -> None:
        """Close the port; wait up to `timeout_s` for one that blocks."""
        self._is_started = False
        self._close()

    def take_sent_count(self) -> int:
        """Return the number of bytes sent to the device since the last call."""
        count, self._written = self._written, 0
        return count

    def read(self, counts: SentBytes) -> Iterator[Chunk]:
        """Yield the bytes that the device reports to have sent, with their times."""
        data, end = b"", time.monotonic() + _TERMINAL_TIMEOUT_S
        total = sum(count for _, count in counts)
        while self._transport is not None and len(data) < total:
            assert time.monotonic() < end, f"{self._label}: {len(data)} of {total} bytes received"
            try:
                data += self._transport.read(_TERMINAL_TIMEOUT_S)[0]
            except LinkDown as down:
                self._report_loss(str(down))
        for t_ns, count in counts:
            part, data = data[:count], data[count:]
            if part:
                yield Chunk(self._label, t_ns, part, "")

    def poll(self) -> None:
        """Check the open device, or try to open it again."""
        now_ns = self._computer.now_ns()
        if not self._is_started or now_ns < self._retry_ns:
            return
        if self._transport is not None:
            try:
                self._transport.read(0.0)
            except LinkDown as down:
                self._report_loss(str(down))
            return
        self._retry_ns = now_ns + _RETRY_INTERVAL_NS
        try:
            self.open_now()
        except LinkError as error:
            if not self._loss_reported:
                self._loss_reported = True
                self._computer.put(LinkLost(self._label, now_ns, str(error)))

    def _report_loss(self, cause: str) -> None:
        self._close()
        self._loss_reported = True
        self._retry_ns = self._computer.now_ns() + _RETRY_INTERVAL_NS
        self._computer.put(LinkLost(self._label, self._computer.now_ns(), cause))

    def _close(self) -> None:
        if self._transport is not None:
            self._transport.close()
        self._transport, self.device_path = None, ""
