"""A sink that writes the log and passes what is written on to the outputs that follow it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, cast

from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.sink import Sink

Listener = Callable[[str, tuple[Any, ...], dict[str, Any], Any], None]
"""listener(method of the sink, its arguments, its keywords, its result); must return at once."""

_METHODS = (
    *("write_imu", "write_temperature", "write_battery", "write_magnetic_field", "write_bias_filter"),
    *("write_odometry", "write_transform", "write_gnss_fix", "write_columns", "write_raw_frame"),
    *("write_clock_request", "write_event", "add_metadata", "add_channel", "write"),
)


def tee_sink(sink: Sink, listeners: Mapping[str, Listener], bulkheads: Bulkheads) -> Sink:
    """Return a sink that calls `sink` uninterrupted, then each listener as a part of its name."""
    return cast(Sink, _TeeSink(sink, listeners, bulkheads))


class _TeeSink:
    def __init__(self, sink: Sink, listeners: Mapping[str, Listener], bulkheads: Bulkheads) -> None:
        for name in _METHODS:
            setattr(self, name, _both(name, getattr(sink, name), listeners, bulkheads))


def _both(
    name: str, write: Callable[..., Any], listeners: Mapping[str, Listener], bulkheads: Bulkheads
) -> Callable[..., Any]:
    def method(*args: Any, **named: Any) -> Any:
        with bulkheads.protect_write():
            result = write(*args, **named)
        for part, listener in listeners.items():
            bulkheads.run(part, listener, name, args, named, result, pausing=True)
        return result

    return method
