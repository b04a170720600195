"""What the page shows of the records that go into the log, and the recorder does not keep."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from hubodo.recording import Event


class Ear:
    """Small numbers from what is written: the mean spin of each node, fixes and events."""

    def __init__(self, most_events: int) -> None:
        self.events: deque[Event] = deque(maxlen=most_events)
        """Those that nobody has taken yet."""
        self.fix: tuple[float, float, float | None] | None = None
        """Latitude, longitude, degrees, and 1 sigma, m, of a fix that nobody has taken yet."""
        self._spin: dict[str, tuple[float, int]] = {}

    def hear(self, name: str, args: tuple[Any, ...], named: dict[str, Any], given: Any) -> None:
        """See `hubodo.ingest.live.tee_sink.Listener`."""
        if name == "write_imu":
            node, gyro = args[0], np.asarray(args[3])
            total, count = self._spin.get(node, (0.0, 0))
            self._spin[node] = (total + float(gyro[:, 2].sum()), count + len(gyro))
        elif name == "write_event":
            self.events.append(args[0])
        elif name == "write_gnss_fix" and np.ravel(named.get("status", 0))[-1] >= 0:
            sigma = named.get("sigma")
            across = None if sigma is None else float(np.hypot(*np.ravel(sigma)[:2]) / np.sqrt(2.0))
            self.fix = (float(np.ravel(args[2])[-1]), float(np.ravel(args[3])[-1]), across)

    def spins(self) -> dict[str, float]:
        """Mean rate about z of each node's samples since the last call, rad/s, node axes, raw."""
        spins = {node: total / count for node, (total, count) in self._spin.items()}
        self._spin.clear()
        return spins

    def take_events(self) -> list[Event]:
        """The events since the last call."""
        taken = list(self.events)
        self.events.clear()
        return taken
