"""Result of a recording: its values, JSON and text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class RecordResult:
    """Result of a recording. Times in s, rates in Hz, sizes in bytes; keys of `as_json` are stable.

    Attributes
    ----------
    file
        The newest of `files`.
    files
        All logs in order, including those removed to free disk space.
    messages_lost
        Messages contained in no log, for lack of disk space or because a log was deleted.
    removed
        Number of logs removed.
    trouble
        Cause of an interruption of the log; None without one.
    faults
        Number of exceptions and hangs by part of the recorder.
    """

    OUTPUT_DEADLINE: ClassVar[float] = 5.0
    """Seconds after which the process exits although nobody reads the result."""

    file: str
    files: tuple[str, ...]
    messages_lost: int
    removed: int
    trouble: str | None
    duration: float
    messages: int
    size: int
    nodes: dict[str, dict[str, Any]]
    links: dict[str, dict[str, Any]]
    gnss: dict[str, dict[str, Any]]
    odometry: dict[str, Any] | None
    map: dict[str, Any] | None
    faults: dict[str, int]

    @property
    def failed(self) -> bool:
        """True if received data is contained in no log."""
        return self.messages_lost > 0 or self.trouble is not None

    def as_json(self) -> dict[str, Any]:
        """Return the result with stable keys."""
        return {
            "file": self.file,
            "files": list(self.files),
            "messages_lost": self.messages_lost,
            "logs_removed": self.removed,
            "trouble": self.trouble,
            "duration": self.duration,
            "messages": self.messages,
            "size": self.size,
            "nodes": self.nodes,
            "links": self.links,
            "gnss": self.gnss,
            "odometry": self.odometry,
            "map": self.map,
            "faults": self.faults,
        }

    def render(self, console: Console) -> None:
        """Print the result as text and a table of nodes."""
        logs = self.file if len(self.files) < 2 else f"{len(self.files)} logs up to {self.file}"
        console.print(
            f"{logs}: {self.duration:.1f} s, {self.messages} messages, {self.size / 1e6:.2f} MB",
            highlight=False,
        )
        if self.removed:
            console.print(f"{self.removed} logs removed to free disk space", highlight=False)
        if self.failed:
            why = self.trouble or "see the warnings"
            console.print(f"NOT RECORDED: {self.messages_lost} messages ({why})", highlight=False)
        table = Table(
            "node", "samples", "rate Hz", "lost", "gaps", "restarts", "clock drift", "clock 1 sigma"
        )
        for name, node in self.nodes.items():
            clock = node["clock"]
            rate = node["rate_hz"]
            table.add_row(
                name,
                str(node["samples"]),
                "-" if rate is None else f"{rate:.2f}",
                str(node["samples_lost"]),
                ", ".join(f"{count} {cause}" for cause, count in node["gaps"].items()) or "none",
                str(node["restarts"]),
                f"{clock['drift_ppm']:+.1f} ± {clock['drift_sigma_ppm']:.1f} ppm",
                "-" if clock["source"] == "none" else f"{clock['sigma'] * 1e3:.3f} ms ({clock['source']})",
            )
        if self.nodes:
            console.print(table)
        for label, link in self.links.items():
            console.print(
                f"link {label}: {link['frames']} frames, {link['frames_damaged']} damaged, "
                f"{link['disconnections']} times disconnected",
                highlight=False,
            )
        for label, gnss in self.gnss.items():
            console.print(
                f"gnss {label}: {gnss['fixes']} fixes, {gnss['checksum_errors']} bad checksums, "
                f"{gnss['unread']} sentences not parsed",
                highlight=False,
            )
        for part, count in self.faults.items():
            console.print(f"{part}: {count} faults, see the events of the log", highlight=False)
        if self.odometry is not None:
            console.print(_describe_odometry(self.odometry), highlight=False)
        if self.map is not None:
            console.print(_describe_map(self.map), highlight=False)


def _describe_odometry(odometry: dict[str, Any]) -> str:
    if not odometry["poses"]:
        return "odometry: no pose; it requires one second of samples of a wheel node in the vehicle file"
    return (
        f"odometry from {' and '.join(odometry['nodes'])}: {odometry['poses']} poses, "
        f"{odometry['distance']:.2f} m; {_describe_latency(odometry)}"
    )


def _describe_map(fields: dict[str, Any]) -> str:
    if not fields["poses"]:
        return "map → odom: none; the heading was not observable from the fixes, or odometry was missing"
    origin = f"latitude {fields['latitude_deg']:.7f}, longitude {fields['longitude_deg']:.7f} degrees"
    return (
        f"map → odom from GNSS and odometry: {fields['poses']} poses; "
        f"last {fields['x']:.2f}, {fields['y']:.2f} m from {origin}, "
        f"1 sigma {fields['sigma']:.2f} m; {_describe_latency(fields)}"
    )


def _describe_latency(fields: dict[str, Any]) -> str:
    median, p99, worst = (fields[f"latency_{key}"] * 1e3 for key in ("median", "p99", "worst"))
    return f"latency {median:.2f} ms median, {p99:.2f} ms p99, {worst:.2f} ms worst"
