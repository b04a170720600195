"""Views of a running recording: a live table, lines of text, or JSON lines for services."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from types import TracebackType
from typing import IO, Any, Protocol, Self

from rich.console import Console
from rich.live import Live

from hubodo.ingest.live.live_table import (
    describe_odometry,
    draw_snapshot,
    format_size,
    link_state,
    node_state,
)
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.ingest.live.timeout_stream import standard_error
from hubodo.recording import Event
from hubodo.safe_text import json_text
from hubodo.terminal import SafeConsole
from hubodo.units import NS_PER_S

_LINE_INTERVAL_NS = 10 * NS_PER_S
_WARNING_KINDS = (
    *("clock", "damage", "disconnected", "fault", "foreign", "full", "gap_seen"),
    *("mismatch", "silent", "warning"),
)
"""Kinds of events shown at level warning; all others are info."""


class View(Protocol):
    """A view of a recording; a context manager."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def show_notice(self, notice: Event | str) -> None:
        """Show one line permanently."""
        ...

    def show(self, snapshot: Snapshot) -> None:
        """Show the present status; to be called about once per second."""
        ...


def create_view(config: RecordConfig, now_ns: Callable[[], int], console: Console | None = None) -> View:
    """Return a live table on a terminal, lines elsewhere; now_ns: host time; console: None for stderr."""
    console = console or SafeConsole(file=standard_error())
    if config.log_format == "json":
        return JsonView(console.file, now_ns, quiet=config.quiet)
    if config.quiet or not console.is_terminal or console.is_dumb_terminal:
        return LineView(console, now_ns(), quiet=config.quiet)
    return TableView(console)


class _StatelessView:
    """A view without resources to open or close."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class TableView:
    """A table redrawn with each snapshot and removed at the end; notices scroll above it."""

    def __init__(self, console: Console) -> None:
        self._console = console
        # Drawn only in `show`: a refresh thread of rich would delay the recording at any time.
        # Output is not redirected, because other threads would wait for the lock of rich.
        self._live = Live(
            console=console,
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def show_notice(self, notice: Event | str) -> None:
        """Show one line permanently."""
        _print_notice(self._console, notice)

    def show(self, snapshot: Snapshot) -> None:
        """Show the present status; to be called about once per second."""
        self._live.update(draw_snapshot(snapshot, self._console.width), refresh=True)


class LineView(_StatelessView):
    """A line of status every ten seconds (none with `quiet`), and notices."""

    def __init__(self, console: Console, start_ns: int, *, quiet: bool) -> None:
        self._console, self._quiet, self._next_ns = console, quiet, start_ns + _LINE_INTERVAL_NS

    def show_notice(self, notice: Event | str) -> None:
        """Show one line permanently."""
        _print_notice(self._console, notice)

    def show(self, snapshot: Snapshot) -> None:
        """Show the present status; to be called about once per second."""
        if self._quiet or snapshot.t_ns < self._next_ns:
            return
        self._next_ns = snapshot.t_ns + _LINE_INTERVAL_NS
        states = [(node.name, node_state(node, snapshot)) for node in snapshot.nodes]
        links_with_nodes = {node.link for node in snapshot.nodes}
        states += [
            (link.label, link_state(link)) for link in snapshot.links if link.label not in links_with_nodes
        ]
        parts = [
            f"{node.name} {node.rate:.1f} Hz, {node.samples_lost} samples lost" for node in snapshot.nodes
        ]
        parts += [f"{name} {state}" for name, state in states if state != "up"]
        parts += [describe_odometry(snapshot.odometry)] if snapshot.odometry is not None else []
        parts[:0] = [f"NOT RECORDING: {snapshot.log.trouble}"] if not snapshot.log.recording else []
        head = f"{snapshot.seconds:.0f} s, {format_size(snapshot.log.total)}"
        self.show_notice(f"{head}: {'; '.join(parts) or 'no node yet'}")


def _print_notice(console: Console, notice: Event | str) -> None:
    text = notice if isinstance(notice, str) else notice.text
    console.print(f"hubodo record: {text}", highlight=False, soft_wrap=True, markup=False)


class JsonView:
    """One JSON object per line: start, notices, the status every ten seconds, end.

    Keys: `time` (ISO 8601, UTC, by the recorder's clock), `level` (info, warning), `event` (one word),
    `text`, `fields`.
    """

    def __init__(self, out: IO[str], now_ns: Callable[[], int], *, quiet: bool) -> None:
        self._out, self._quiet, self._now_ns = out, quiet, now_ns
        self._next_ns = now_ns() + _LINE_INTERVAL_NS

    def __enter__(self) -> Self:
        self._write_line(self._now_ns(), "info", "started", "recording", {})
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._write_line(self._now_ns(), "info", "stopped", "recording has ended", {})

    def show_notice(self, notice: Event | str) -> None:
        """Show one line permanently."""
        if isinstance(notice, str):
            self._write_line(self._now_ns(), "info", "notice", notice, {})
            return
        level = "warning" if notice.kind in _WARNING_KINDS else "info"
        self._write_line(
            notice.t_ns, level, notice.kind, notice.text, {"source": notice.source, **notice.data}
        )

    def show(self, snapshot: Snapshot) -> None:
        """Show the present status; to be called about once per second."""
        if self._quiet or snapshot.t_ns < self._next_ns:
            return
        self._next_ns = snapshot.t_ns + _LINE_INTERVAL_NS
        text = f"{snapshot.seconds:.0f} s, {format_size(snapshot.log.total)}"
        self._write_line(snapshot.t_ns, "info", "status", text, asdict(snapshot))

    def _write_line(self, t_ns: int, level: str, event: str, text: str, fields: dict[str, Any]) -> None:
        print(format_json_line(t_ns, level, event, text, fields), file=self._out, flush=True)


def format_json_line(t_ns: int, level: str, event: str, text: str, fields: dict[str, Any]) -> str:
    """Return one JSON line of the program log; t_ns: since 1970."""
    when = datetime.fromtimestamp(t_ns // NS_PER_S, UTC).strftime("%Y-%m-%dT%H:%M:%S")
    line = {"time": f"{when}.{t_ns % NS_PER_S // 1000:06d}Z", "level": level, "event": event, "text": text}
    return json_text({**line, "fields": fields}, ascii_only=False)
