"""Terminal view of a snapshot: one line per node, one for the log, one for the odometry."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hubodo.ingest.live.snapshot import LinkStatus, LogStatus, NodeStatus, OdometryStatus, Snapshot
from hubodo.safe_text import printable

State = Literal["up", "asleep", "silent", "down", "waiting", "no node", "foreign", "refused"]
_STATE_COLOURS: dict[State, str] = {
    "up": "green",
    "asleep": "blue",
    "silent": "yellow",
    "no node": "yellow",
    "waiting": "yellow",
    "foreign": "red",
    "down": "red",
    "refused": "red",
}
_SILENCE_TIMEOUT_S, _SLEEP_TIMEOUT_S = 2.0, 20.0  # an asleep node reports every 4 s
_MAX_SHOWN_REMAINING_S, _LOW_REMAINING_S, _MIN_RATE_DURATION_S = 48 * 3600.0, 600.0, 5.0
_SIZE_UNITS = ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB"))


def draw_snapshot(snapshot: Snapshot, width: int) -> RenderableType:
    """Return the view for a terminal of `width` columns."""
    title = ("● recording ", "bold red") if snapshot.log.recording else ("○ NOT RECORDING ", "bold yellow")
    head = Text.assemble(title, (format_duration(snapshot.seconds), "bold"), ("   ctrl-C stops", "dim"))
    return Group(head, _draw_nodes(snapshot, width), _draw_summary(snapshot))


def link_state(link: LinkStatus) -> State:
    """Return the state of a link without a node; waiting: its port was never open."""
    if link.where is None:
        return "down" if link.disconnections else "waiting"
    return "no node" if link.foreign is None else "foreign"


def node_state(node: NodeStatus, snapshot: Snapshot) -> State:
    """Return the state of a node; silent: link open but no frames; refused: wire mismatch; asleep: parked."""
    link = next((link for link in snapshot.links if link.label == node.link), None)
    if link is None or link.where is None:
        return "down"
    if node.refused is not None:
        return "refused"
    if node.asleep and node.age <= _SLEEP_TIMEOUT_S:
        return "asleep"
    return "silent" if node.age > _SILENCE_TIMEOUT_S else "up"


def describe_odometry(odometry: OdometryStatus) -> str:
    """Describe distance, speed and position in one line."""
    heading = (math.degrees(odometry.heading) + 180.0) % 360.0 - 180.0
    return (
        f"{odometry.distance:.1f} m, {odometry.speed:.2f} m/s, "
        f"at x {odometry.x:.2f}, y {odometry.y:.2f} ± {odometry.sigma:.2f} m, heading {heading:+.0f}°"
    )


def format_size(size: float) -> str:
    """Return a number of bytes with a decimal unit prefix."""
    for step, unit in _SIZE_UNITS:
        if size >= step:
            return f"{size / step:.3g} {unit}" if size < 100 * step else f"{size / step:.0f} {unit}"
    return f"{size:.0f} B"


def format_duration(seconds: float) -> str:
    """Return a duration as hours:minutes:seconds."""
    whole_s = int(seconds)
    return f"{whole_s // 3600}:{whole_s // 60 % 60:02d}:{whole_s % 60:02d}"


def _draw_nodes(snapshot: Snapshot, width: int) -> Table:
    """Return the table of nodes with the columns that fit the width, most important first."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("  node", min_width=8, overflow="fold")
    table.add_column("link")  # long text is folded so that no other column shrinks
    shown = [column for column in _COLUMNS if width >= column.min_terminal_width]
    for column in shown:
        table.add_column(column.name, justify="right", no_wrap=True, min_width=column.min_width)
    for link in snapshot.links:
        nodes = [node for node in snapshot.nodes if node.link == link.label]
        damaged = f", {link.frames_damaged} damaged" if link.frames_damaged else ""
        if not nodes:
            state = link_state(link)
            where = Text.assemble(f"{link.label} ", (f"{state}{damaged}", _STATE_COLOURS[state]))
            table.add_row(Text.assemble(("● ", _STATE_COLOURS[state]), "-"), where)
        for node in nodes:
            state = node_state(node, snapshot)
            words = f"{state} {node.age:.0f} s" if state == "silent" else state
            label = f"{link.label} " if link.label != node.name else ""
            table.add_row(
                Text.assemble(("● ", _STATE_COLOURS[state]), node.name),
                Text.assemble(label, (f"{words}{damaged}", _STATE_COLOURS[state])),
                *(column.cell(node) for column in shown),
            )
    return table


def _draw_summary(snapshot: Snapshot) -> Table:
    table = Table(box=None, pad_edge=False, show_header=False, padding=(0, 2, 0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("log", _describe_log(snapshot.log, snapshot.seconds))
    for gnss in snapshot.gnss:
        table.add_row(gnss.label, f"{gnss.fixes} fixes, {gnss.checksum_errors} bad checksums")
    if snapshot.odometry is not None:
        table.add_row("odometry", describe_odometry(snapshot.odometry))
    if snapshot.map is not None:
        table.add_row("map", f"x {snapshot.map[0]:.1f}, y {snapshot.map[1]:.1f} m")
    return table


def _describe_log(log: LogStatus, seconds: float) -> Text:
    words = Text(f"{printable(str(log.path))}   {format_size(log.size)}")
    if log.logs > 1:
        words.append(f"   log {log.logs}, {format_size(log.total)} in total")
    if log.disk_free is not None:
        bytes_per_s = log.total / seconds if seconds >= _MIN_RATE_DURATION_S else 0.0
        remaining_s = log.disk_free / bytes_per_s if bytes_per_s else math.inf
        remaining_text = (
            f", enough for {format_duration(remaining_s)}" if remaining_s < _MAX_SHOWN_REMAINING_S else ""
        )
        words.append(
            f"   {format_size(log.disk_free)} free on disk{remaining_text}",
            style="red" if remaining_s < _LOW_REMAINING_S else "",
        )
    if log.trouble is not None:
        words.append(f"\n{log.trouble}", style="red")
    return words


def _format_lost(node: NodeStatus) -> Text:
    if not node.samples_lost:
        return Text("0")
    share = node.samples_lost / (node.samples + node.samples_lost)
    return Text(f"{node.samples_lost} {100 * share:.2g}%", style="yellow")


def _format_bias(node: NodeStatus) -> str:
    return " ".join(f"{math.degrees(axis):+.2f}" for axis in node.bias) if node.bias is not None else ""


class _Column(NamedTuple):
    """A table column and the minimum width of a terminal that shows it."""

    name: str
    min_width: int
    min_terminal_width: int
    cell: Callable[[NodeStatus], str | Text]


_COLUMNS = (
    _Column("Hz", 6, 0, lambda node: f"{node.rate:.1f}"),
    _Column("lost", 4, 0, _format_lost),
    _Column("°C", 4, 60, lambda node: f"{node.temperature:.1f}" if node.temperature is not None else ""),
    _Column("battery", 7, 70, lambda node: f"{node.battery:.2f} V" if node.battery is not None else ""),
    _Column(
        "clock",
        9,
        80,
        lambda node: f"± {node.clock_sigma * 1e3:.2f} ms" if node.clock_sigma is not None else "",
    ),
    _Column("drift", 8, 100, lambda node: f"{node.clock_drift * 1e6:+.0f} ppm" if node.clock_drift else ""),
    _Column("bias °/s", 17, 110, _format_bias),
)
