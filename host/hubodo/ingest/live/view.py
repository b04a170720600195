"""How a recording shows itself while it runs: a live table, lines in a journal, or JSON for services."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from types import TracebackType
from typing import IO, Any, Protocol, Self

from rich.console import Console
from rich.live import Live

from hubodo.ingest.live.live_table import draw, link_state, node_state, odometry_words, size_words
from hubodo.ingest.live.patient_stream import standard_error
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.snapshot import Snapshot
from hubodo.recording import Event
from hubodo.safe_text import json_text
from hubodo.terminal import SafeConsole
from hubodo.units import NS_PER_S

_LINE_NS = 10 * NS_PER_S
_TROUBLE = (
    *("clock", "damage", "disconnected", "fault", "foreign", "full", "gap_seen"),
    *("mismatch", "silent", "warning"),
)
"""Kinds of events that are warnings; others are for information."""


class View(Protocol):
    """Shows a recording inside `with`."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def say(self, notice: Event | str) -> None:
        """One line that stays."""
        ...

    def show(self, snapshot: Snapshot) -> None:
        """How it fares; to be called about once a second."""
        ...


def make_view(config: RecordConfig, now_ns: Callable[[], int], console: Console | None = None) -> View:
    """Return a live table on a terminal, lines elsewhere; now_ns: host time; console: None, stderr."""
    console = console or SafeConsole(file=standard_error())
    if config.log_format == "json":
        return JsonView(console.file, now_ns, quiet=config.quiet)
    if config.quiet or not console.is_terminal or console.is_dumb_terminal:
        return LineView(console, now_ns(), quiet=config.quiet)
    return TableView(console)


class _Plain:
    """A view that has nothing to open or close."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class TableView:
    """A table that is drawn again with each snapshot and is gone at the end; notices scroll by above it."""

    def __init__(self, console: Console) -> None:
        self._console = console
        # Drawn in `show`: a thread of its own would hold up the recording as long, at any time.
        # Nor may others print through it, who would wait for its lock.
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

    def say(self, notice: Event | str) -> None:
        """See `View`."""
        _print(self._console, notice)

    def show(self, snapshot: Snapshot) -> None:
        """See `View`."""
        self._live.update(draw(snapshot, self._console.width), refresh=True)


class LineView(_Plain):
    """A line every ten seconds, or with `quiet` none; notices."""

    def __init__(self, console: Console, start_ns: int, *, quiet: bool) -> None:
        self._console, self._quiet, self._next_ns = console, quiet, start_ns + _LINE_NS

    def say(self, notice: Event | str) -> None:
        """See `View`."""
        _print(self._console, notice)

    def show(self, snapshot: Snapshot) -> None:
        """See `View`."""
        if self._quiet or snapshot.t_ns < self._next_ns:
            return
        self._next_ns = snapshot.t_ns + _LINE_NS
        states = [(node.name, node_state(node, snapshot)) for node in snapshot.nodes]
        spoken = {node.link for node in snapshot.nodes}
        states += [(link.label, link_state(link)) for link in snapshot.links if link.label not in spoken]
        parts = [
            f"{node.name} {node.rate:.1f} Hz, {node.samples_lost} samples lost" for node in snapshot.nodes
        ]
        parts += [f"{name} {state}" for name, state in states if state != "up"]
        parts += [odometry_words(snapshot.odometry)] if snapshot.odometry is not None else []
        parts[:0] = [f"NOT RECORDING: {snapshot.log.trouble}"] if not snapshot.log.recording else []
        head = f"{snapshot.seconds:.0f} s, {size_words(snapshot.log.total)}"
        self.say(f"{head}: {'; '.join(parts) or 'no node yet'}")


def _print(console: Console, notice: Event | str) -> None:
    text = notice if isinstance(notice, str) else notice.text
    console.print(f"hubodo record: {text}", highlight=False, soft_wrap=True, markup=False)


class JsonView:
    """One JSON object a line: the start, notices as they come, the state every ten seconds, the end.

    Keys: `time` (ISO 8601, UTC, by the recorder's clock), `level` (info, warning), `event` (one word),
    `text`, `fields`.
    """

    def __init__(self, out: IO[str], now_ns: Callable[[], int], *, quiet: bool) -> None:
        self._out, self._quiet, self._now_ns = out, quiet, now_ns
        self._next_ns = now_ns() + _LINE_NS

    def __enter__(self) -> Self:
        self._put(self._now_ns(), "info", "started", "recording", {})
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._put(self._now_ns(), "info", "stopped", "recording has ended", {})

    def say(self, notice: Event | str) -> None:
        """See `View`."""
        if isinstance(notice, str):
            self._put(self._now_ns(), "info", "notice", notice, {})
            return
        level = "warning" if notice.kind in _TROUBLE else "info"
        self._put(notice.t_ns, level, notice.kind, notice.text, {"source": notice.source, **notice.data})

    def show(self, snapshot: Snapshot) -> None:
        """See `View`."""
        if self._quiet or snapshot.t_ns < self._next_ns:
            return
        self._next_ns = snapshot.t_ns + _LINE_NS
        text = f"{snapshot.seconds:.0f} s, {size_words(snapshot.log.total)}"
        self._put(snapshot.t_ns, "info", "status", text, asdict(snapshot))

    def _put(self, t_ns: int, level: str, event: str, text: str, fields: dict[str, Any]) -> None:
        print(json_line(t_ns, level, event, text, fields), file=self._out, flush=True)


def json_line(t_ns: int, level: str, event: str, text: str, fields: dict[str, Any]) -> str:
    """One object of a log for programs; t_ns: since 1970."""
    when = datetime.fromtimestamp(t_ns // NS_PER_S, UTC).strftime("%Y-%m-%dT%H:%M:%S")
    whole = {"time": f"{when}.{t_ns % NS_PER_S // 1000:06d}Z", "level": level, "event": event, "text": text}
    return json_text({**whole, "fields": fields}, ascii_only=False)
