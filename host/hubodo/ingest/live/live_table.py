"""A snapshot drawn for a terminal: a line for each node, one for the log, one for the odometry."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from hubodo.ingest.live.snapshot import LinkNow, LogNow, NodeNow, OdometryNow, Snapshot
from hubodo.safe_text import printable

State = Literal["up", "silent", "down", "waiting", "no node", "foreign", "refused"]
_COLOURS: dict[State, str] = {
    "up": "green",
    "silent": "yellow",
    "no node": "yellow",
    "waiting": "yellow",
    "foreign": "red",
    "down": "red",
    "refused": "red",
}
_SILENT_S = 2.0
_LONG_S, _SCARCE_S, _PACE_S = 48 * 3600.0, 600.0, 5.0
_STEPS = ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB"))


def draw(seen: Snapshot, width: int) -> RenderableType:
    """What the terminal of that many columns shows."""
    title = ("● recording ", "bold red") if seen.log.recording else ("○ NOT RECORDING ", "bold yellow")
    head = Text.assemble(title, (clock_words(seen.seconds), "bold"), ("   ctrl-C stops", "dim"))
    return Group(head, _nodes(seen, width), _below(seen))


def link_state(link: LinkNow) -> State:
    """Of a link on which no node has spoken; waiting: it has not been there yet."""
    if link.where is None:
        return "down" if link.disconnections else "waiting"
    return "no node" if link.foreign is None else "foreign"


def node_state(node: NodeNow, seen: Snapshot) -> State:
    """up: samples come; silent: its link is open; refused: it speaks another version."""
    link = next((link for link in seen.links if link.label == node.link), None)
    if link is None or link.where is None:
        return "down"
    if node.refused is not None:
        return "refused"
    return "silent" if node.age > _SILENT_S else "up"


def odometry_words(odometry: OdometryNow) -> str:
    """Distance, speed and place."""
    heading = (math.degrees(odometry.heading) + 180.0) % 360.0 - 180.0
    return (
        f"{odometry.distance:.1f} m, {odometry.speed:.2f} m/s, "
        f"at x {odometry.x:.2f}, y {odometry.y:.2f} ± {odometry.sigma:.2f} m, heading {heading:+.0f}°"
    )


def size_words(size: float) -> str:
    """A number of bytes for people."""
    for step, unit in _STEPS:
        if size >= step:
            return f"{size / step:.3g} {unit}" if size < 100 * step else f"{size / step:.0f} {unit}"
    return f"{size:.0f} B"


def clock_words(seconds: float) -> str:
    """Hours, minutes and seconds."""
    whole = int(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def _nodes(seen: Snapshot, width: int) -> Table:
    """The columns for which there is room, the most telling first."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("  node", min_width=8, overflow="fold")
    table.add_column("link")  # what is long folds: no other column gives way
    shown = [column for column in _COLUMNS if width >= column.from_width]
    for column in shown:
        table.add_column(column.name, justify="right", no_wrap=True, min_width=column.least)
    for link in seen.links:
        nodes = [node for node in seen.nodes if node.link == link.label]
        damaged = f", {link.frames_damaged} damaged" if link.frames_damaged else ""
        if not nodes:
            state = link_state(link)
            where = Text.assemble(f"{link.label} ", (f"{state}{damaged}", _COLOURS[state]))
            table.add_row(Text.assemble(("● ", _COLOURS[state]), "-"), where)
        for node in nodes:
            state = node_state(node, seen)
            words = f"{state} {node.age:.0f} s" if state == "silent" else state
            label = f"{link.label} " if link.label != node.name else ""
            table.add_row(
                Text.assemble(("● ", _COLOURS[state]), node.name),
                Text.assemble(label, (f"{words}{damaged}", _COLOURS[state])),
                *(column.cell(node) for column in shown),
            )
    return table


def _below(seen: Snapshot) -> Table:
    table = Table(box=None, pad_edge=False, show_header=False, padding=(0, 2, 0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("log", _log(seen.log, seen.seconds))
    for gnss in seen.gnss:
        table.add_row(gnss.label, f"{gnss.fixes} fixes, {gnss.checksum_errors} bad checksums")
    if seen.odometry is not None:
        table.add_row("odometry", odometry_words(seen.odometry))
    if seen.map is not None:
        table.add_row("map", f"x {seen.map[0]:.1f}, y {seen.map[1]:.1f} m")
    return table


def _log(log: LogNow, seconds: float) -> Text:
    words = Text(f"{printable(str(log.path))}   {size_words(log.size)}")
    if log.logs > 1:
        words.append(f"   log {log.logs}, {size_words(log.total)} in all")
    if log.disk_free is not None:
        pace = log.total / seconds if seconds >= _PACE_S else 0.0
        lasts = log.disk_free / pace if pace else math.inf
        lasting = f", for {clock_words(lasts)}" if lasts < _LONG_S else ""
        words.append(
            f"   {size_words(log.disk_free)} left on disk{lasting}", style="red" if lasts < _SCARCE_S else ""
        )
    if log.trouble is not None:
        words.append(f"\n{log.trouble}", style="red")
    return words


def _lost(node: NodeNow) -> Text:
    if not node.samples_lost:
        return Text("0")
    share = node.samples_lost / (node.samples + node.samples_lost)
    return Text(f"{node.samples_lost} {100 * share:.2g}%", style="yellow")


def _bias(node: NodeNow) -> str:
    return " ".join(f"{math.degrees(axis):+.2f}" for axis in node.bias) if node.bias is not None else ""


class _Column(NamedTuple):
    """A column, and how wide the terminal must be for it."""

    name: str
    least: int
    from_width: int
    cell: Callable[[NodeNow], str | Text]


_COLUMNS = (
    _Column("Hz", 6, 0, lambda node: f"{node.rate:.1f}"),
    _Column("lost", 4, 0, _lost),
    _Column("°C", 4, 60, lambda node: f"{node.temperature:.1f}" if node.temperature is not None else ""),
    _Column("battery", 7, 70, lambda node: f"{node.battery:.2f} V" if node.battery is not None else ""),
    _Column(
        "clock",
        9,
        80,
        lambda node: f"± {node.clock_sigma * 1e3:.2f} ms" if node.clock_sigma is not None else "",
    ),
    _Column("drift", 8, 100, lambda node: f"{node.clock_drift * 1e6:+.0f} ppm" if node.clock_drift else ""),
    _Column("bias °/s", 17, 110, _bias),
)
