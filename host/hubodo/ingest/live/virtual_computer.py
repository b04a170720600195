"""A computer in virtual time: its clock goes on while somebody waits for news, as far as its devices live.

What is slow or stopped for a while is so in the wall clock's time alone: nothing here comes late for it.
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

_STEP_NS = NS_PER_S // 100
_RETRY_NS = NS_PER_S // 20
_KERNEL_S = 20.0
"""For what has been written on one side of a terminal to be readable on the other."""

Sent = list[tuple[int, int]]
"""(ns, bytes) of what a device has put on its port, by time."""


class Device(Protocol):
    """Something on a serial port that lives in virtual time; `path`: the terminal of the moment."""

    path: str

    def live_until(self, t_ns: int, heard: int | None) -> None:
        """Begins to, with the next so many bytes of its host; None where nobody has its port open."""
        ...

    def sent(self) -> Sent:
        """Once it has lived so far: what it put on its port for a host that has it open."""
        ...


class VirtualComputer:
    """See `Computer`."""

    def __init__(
        self,
        passed: Callable[[int], None] = lambda t_ns: None,
        *,
        start_ns: int | None = None,
        folder: Path | None = None,
    ) -> None:
        """passed: called with the virtual time, ns, after each step of it.

        start_ns: what its clock shows first, None: as the wall clock of now. folder: in which devices are
        told by their names alone, so that nothing of this computer gets into what is recorded.
        """
        self._now_ns = time.time_ns() if start_ns is None else start_ns
        self._passed = passed
        self._folder = folder
        self._devices: list[Device] = []
        self._led_to: dict[str, tuple[str, str]] = {}
        self._links: list[VirtualLink] = []
        self._news: deque[Any] = deque()

    def plug_in(self, device: Device) -> None:
        """From now on it lives, before those that come later."""
        self._devices.append(device)

    def now_ns(self) -> int:
        """See `Computer`."""
        return self._now_ns

    def wall_ns(self) -> int:
        """See `Computer`."""
        return self.now_ns()

    def clock_state(self) -> ClockState:
        """See `Computer`."""
        return ClockState.UNKNOWN

    def name_of(self, where: str) -> str:
        """What a device is called in the log."""
        path = Path(where)
        return path.name if self._folder is not None and path.parent == self._folder else where

    def put(self, item: Any) -> None:
        """See `Computer`."""
        self._news.append(item)

    def link(self, port: PortName, label: str, baud: int, lister: DeviceLister) -> VirtualLink:
        """See `Computer`."""
        link = VirtualLink(port, label, self, baud, lister)
        self._links.append(link)
        return link

    def news(self, seconds: float) -> Any:
        """See `Computer`; no time passes while there are some."""
        end_ns = self._now_ns + int(seconds * NS_PER_S)
        while not self._news and self._now_ns < end_ns:
            self._step(min(self._now_ns + _STEP_NS, end_ns))
        return self._news.popleft() if self._news else None

    def _step(self, t_ns: int) -> None:
        links = {link.device_path: link for link in self._links if link.device_path}
        for device in self._devices:
            link = links.get(self._real(device.path))
            device.live_until(t_ns, None if link is None else link.take_count())
        sent = [(links.get(self._real(device.path)), device.sent()) for device in self._devices]
        self._now_ns = t_ns
        came = [chunk for link, counts in sent if link is not None for chunk in link.read(counts)]
        for chunk in sorted(came, key=lambda chunk: chunk.t_ns):
            self.put(chunk)
        for link in self._links:
            link.look()
        self._passed(t_ns)

    def _real(self, path: str) -> str:
        """Where a path leads now; of the way there only what its last link names may have changed."""
        try:
            target = os.readlink(path)  # noqa: PTH115  thousands of times in a recording
        except OSError:
            target = ""
        known, real = self._led_to.get(path, (None, ""))
        if known != target:
            real = os.path.realpath(path)
            self._led_to[path] = target, real
        return real


class VirtualLink:
    """As `PortLink`, on real ports as well, but read by the computer's steps instead of a thread."""

    def __init__(
        self, port: PortName, label: str, computer: VirtualComputer, baud: int, lister: DeviceLister
    ) -> None:
        self.device_path = ""
        """Of the device that is open; empty while none is."""
        self._written = 0
        self._port, self._label, self._computer, self._baud = port, label, computer, baud
        self._finder = DeviceFinder(port, lister)
        self._transport: Transport | None = None
        self._started = self._missed = False
        self._retry_ns = 0

    def open_now(self) -> None:
        """See `Link`."""
        self._transport = open_transport(self._port, self._finder, self._baud)
        self.device_path, self._written, self._missed = os.path.realpath(self._transport.where), 0, False
        where = self._computer.name_of(self._transport.where)
        self._computer.put(LinkUp(self._label, self._computer.now_ns(), where, self._transport.datagrams))

    def start(self) -> None:
        """See `Link`."""
        self._started = True

    def send(self, data: bytes, to: str = "") -> bool:
        """See `Link`."""
        if self._transport is None:
            return False
        try:
            self._transport.write(data, to)
        except LinkDown:
            return False  # the next look meets the same end and reports it
        self._written += len(data)
        return True

    def request_stop(self) -> None:
        """See `Link`."""

    def stop(self, timeout_s: float = 0.0) -> None:
        """See `Link`."""
        self._started = False
        self._close()

    def take_count(self) -> int:
        """Bytes to the device since the last call."""
        count, self._written = self._written, 0
        return count

    def read(self, counts: Sent) -> Iterator[Chunk]:
        """What its device says that it has sent."""
        data, end = b"", time.monotonic() + _KERNEL_S
        total = sum(count for _, count in counts)
        while self._transport is not None and len(data) < total:
            assert time.monotonic() < end, f"{self._label}: {len(data)} of {total} bytes came"
            try:
                data += self._transport.read(_KERNEL_S)[0]
            except LinkDown as down:
                self._lost(str(down))
        for t_ns, count in counts:
            part, data = data[:count], data[count:]
            if part:
                yield Chunk(self._label, t_ns, part, "")

    def look(self) -> None:
        """Whether the device is still there, or is again."""
        now_ns = self._computer.now_ns()
        if not self._started or now_ns < self._retry_ns:
            return
        if self._transport is not None:
            try:
                self._transport.read(0.0)
            except LinkDown as down:
                self._lost(str(down))
            return
        self._retry_ns = now_ns + _RETRY_NS
        try:
            self.open_now()
        except LinkError as error:
            if not self._missed:
                self._missed = True
                self._computer.put(LinkLost(self._label, now_ns, str(error)))

    def _lost(self, why: str) -> None:
        self._close()
        self._missed = True
        self._retry_ns = self._computer.now_ns() + _RETRY_NS
        self._computer.put(LinkLost(self._label, self._computer.now_ns(), why))

    def _close(self) -> None:
        if self._transport is not None:
            self._transport.close()
        self._transport, self.device_path = None, ""
