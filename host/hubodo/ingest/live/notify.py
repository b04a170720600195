"""Tells the service manager how the recorder fares: a few words on the datagram socket that it names.

sd_notify(3): READY=1, STATUS=, WATCHDOG=1, RELOADING=1, STOPPING=1. Where $NOTIFY_SOCKET is not set, nothing
is told.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Mapping

from hubodo.ingest.live.metrics import health
from hubodo.ingest.live.snapshot import Snapshot


class Notifier:
    """See the module. environment: None, that of the process. now: s, monotonic, for the watchdog."""

    def __init__(
        self, environment: Mapping[str, str] | None = None, now: Callable[[], float] = time.monotonic
    ) -> None:
        known = os.environ if environment is None else environment
        name = known.get("NOTIFY_SOCKET", "")
        self._address = f"\0{name[1:]}" if name.startswith("@") else name
        self._now = now
        self._next_alive = 0.0
        self._period: float | None = None
        if known.get("WATCHDOG_USEC", "").isdigit() and known.get("WATCHDOG_PID", _pid()) == _pid():
            self._period = int(known["WATCHDOG_USEC"]) * 1e-6 / 3

    def ready(self) -> None:
        """The recorder listens."""
        self._tell("READY=1")

    def stopping(self) -> None:
        """The recorder ends."""
        self._tell("STOPPING=1")

    def show(self, snapshot: Snapshot) -> None:
        """The state in one line."""
        ok, words = health(snapshot)
        received = sum(node.samples for node in snapshot.nodes)
        lost = sum(node.samples_lost for node in snapshot.nodes)
        counts = f"{len(snapshot.nodes)} nodes, {received} samples, {lost} lost"
        self._tell(f"STATUS={words if ok else f'NOT WELL: {words}'}; {counts}")

    def alive(self) -> None:
        """Call often: says so three times as often as the watchdog asks for."""
        if self._period is None or self._now() < self._next_alive:
            return
        self._next_alive = self._now() + self._period
        self._tell("WATCHDOG=1")

    def _tell(self, text: str) -> None:
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
                out.setblocking(False)
                out.sendto(text.encode(), self._address)
        except OSError:
            pass  # a manager that is busy or gone must not hold up a recording


def _pid() -> str:
    return str(os.getpid())
