"""A device on a pseudo terminal that sends bytes periodically in virtual time and stores received bytes."""

from __future__ import annotations

import os
import select
import tty
from collections.abc import Callable

from hubodo.ingest.live.virtual_computer import SentBytes, VirtualComputer
from hubodo.units import NS_PER_S


class Talker:
    """A periodic sender that runs inside `with`.

    bytes_at: function from the time since the start, s, to bytes, called every `period` s; the bytes are sent
    `late` s afterwards. received: (s since the start, bytes) received from the host.
    """

    def __init__(
        self, computer: VirtualComputer, period: float, bytes_at: Callable[[float], bytes], late: float = 0.0
    ) -> None:
        self._computer, self._bytes_at, self._late_ns = computer, bytes_at, round(late * NS_PER_S)
        self._start_ns, self._period_ns = computer.now_ns(), round(period * NS_PER_S)
        self._due_ns = self._start_ns + self._period_ns
        self._on_port: SentBytes = []
        self.received: list[tuple[float, bytes]] = []
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)

    def __enter__(self) -> Talker:
        self._computer.plug_in(self)
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._slave)
        os.close(self._master)

    def advance_to(self, t_ns: int, sent_count: int | None) -> None:
        left = sent_count or 0
        while left:
            select.select([self._master], [], [])
            t = (self._computer.now_ns() - self._start_ns) / NS_PER_S
            self.received.append((t, os.read(self._master, left)))
            left -= len(self.received[-1][1])
        while self._due_ns + self._late_ns <= t_ns:
            data = self._bytes_at((self._due_ns - self._start_ns) / NS_PER_S)
            if sent_count is not None and data:
                self._on_port.append((self._due_ns + self._late_ns, os.write(self._master, data)))
            self._due_ns += self._period_ns

    def wait_for_writes(self) -> SentBytes:
        sent, self._on_port = self._on_port, []
        return sent
