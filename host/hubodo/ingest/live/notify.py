"""Notifications of the service manager about the state of the recorder (sd_notify(3)).

READY=1, STATUS=, WATCHDOG=1 and STOPPING=1 on the datagram socket $NOTIFY_SOCKET; nothing is sent without it.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Mapping

from hubodo.ingest.live.metrics import assess_health
from hubodo.ingest.live.snapshot import Snapshot


class ServiceNotifier:
    """A client of sd_notify(3); environment: None for that of the process; now: monotonic time, s."""

    def __init__(
        self, environment: Mapping[str, str] | None = None, now: Callable[[], float] = time.monotonic
    ) -> None:
        known = os.environ if environment is None else environment
        name = known.get("NOTIFY_SOCKET", "")
        self._address = f"\0{name[1:]}" if name.startswith("@") else name
        self._now = now
        self._next_watchdog = 0.0
        self._watchdog_period: float | None = None
        if known.get("WATCHDOG_USEC", "").isdigit() and known.get("WATCHDOG_PID", _pid()) == _pid():
            self._watchdog_period = int(known["WATCHDOG_USEC"]) * 1e-6 / 3

    def notify_ready(self) -> None:
        """Notify that the recorder is ready."""
        self._send("READY=1")

    def notify_stopping(self) -> None:
        """Notify that the recorder is stopping."""
        self._send("STOPPING=1")

    def show(self, snapshot: Snapshot) -> None:
        """Send the state in one line."""
        ok, words = assess_health(snapshot)
        received = sum(node.samples for node in snapshot.nodes)
        lost = sum(node.samples_lost for node in snapshot.nodes)
        counts = f"{len(snapshot.nodes)} nodes, {received} samples, {lost} lost"
        self._send(f"STATUS={words if ok else f'FAULT: {words}'}; {counts}")

    def feed_watchdog(self) -> None:
        """Feed the watchdog, three times per watchdog period; to be called often."""
        if self._watchdog_period is None or self._now() < self._next_watchdog:
            return
        self._next_watchdog = self._now() + self._watchdog_period
        self._send("WATCHDOG=1")

    def _send(self, text: str) -> None:
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
                out.setblocking(False)
                out.sendto(text.encode(), self._address)
        except OSError:
            pass  # a busy or missing service manager must not delay a recording


def _pid() -> str:
    return str(os.getpid())
