"""What goes into the log, heard by others as well: what the page shows and the recorder does not keep."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from hubodo.ingest.sink import Sink
from hubodo.recording import Event

Hear = Callable[[str, tuple[Any, ...], dict[str, Any], Any], None]
"""hear(method of the sink, its arguments, its keywords, what it gave back)."""

_METHODS = (
    *("imu", "temperature", "battery", "magnetic_field", "bias_filter", "odometry", "transform", "fix"),
    *("raw", "asked", "event", "add_metadata", "add_channel", "write"),
)


def heard_by(sink: Sink, *listeners: Hear) -> Sink:
    """A sink that does what `sink` does, and tells the listeners of it; arrays are theirs to keep."""
    return cast(Sink, _Heard(sink, listeners))


class _Heard:
    def __init__(self, sink: Sink, listeners: tuple[Hear, ...]) -> None:
        for name in _METHODS:
            setattr(self, name, _both(name, getattr(sink, name), listeners))


def _both(name: str, write: Callable[..., Any], listeners: tuple[Hear, ...]) -> Callable[..., Any]:
    def method(*args: Any, **named: Any) -> Any:
        given = write(*args, **named)
        for hear in listeners:
            hear(name, args, named, given)
        return given

    return method


class Ear:
    """Small numbers from what is written: the mean spin of each node, fixes and events."""

    def __init__(self, most_events: int) -> None:
        self.events: deque[Event] = deque(maxlen=most_events)
        """Those that nobody has taken yet."""
        self.fix: tuple[float, float, float | None] | None = None
        """Latitude, longitude, degrees, and 1 sigma, m, of a fix that nobody has taken yet."""
        self._spin: dict[str, tuple[float, int]] = {}

    def hear(self, name: str, args: tuple[Any, ...], named: dict[str, Any], given: Any) -> None:
        """See `Hear`."""
        if name == "imu":
            node, gyro = args[0], np.asarray(args[3])
            total, count = self._spin.get(node, (0.0, 0))
            self._spin[node] = (total + float(gyro[:, 2].sum()), count + len(gyro))
        elif name == "event":
            self.events.append(args[0])
        elif name == "fix" and np.ravel(named.get("status", 0))[-1] >= 0:
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
