"""Result of a recording as JSON and as text."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from rich.console import Console
from rich.table import Table

from hubodo.ingest.link.session import LinkSession
from hubodo.ingest.live.recorder import Recorder
from hubodo.ingest.node.bias_filter import filter_report_json
from hubodo.ingest.topic.handlers import FixHandler, ImuHandler
from hubodo.ingest.topic.session import OUT_OF_ORDER, UNDECODABLE, TopicSession
from hubodo.log.log_series import LogSeries


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


def build_result(recorder: Recorder, series: LogSeries, *, duration: float, messages: int) -> RecordResult:
    """Return the result of a recorder and its logs; messages: number of messages in them."""
    nodes = {}
    for node in recorder.nodes:
        counts, health = node.decoder.counts, node.health
        nodes[node.name] = {
            "link": node.link,
            "node_id": node.node_id,
            "frames": counts.frames,
            "frames_lost": counts.frames_lost,
            "frames_late": counts.frames_late,
            "frames_unread": counts.frames_undecoded,
            "samples": counts.samples,
            "samples_lost": counts.samples_lost,
            "rate_hz": node.mean_rate(),
            "saturated_batches": counts.saturated_batches,
            "gaps": dict(node.gaps),
            "restarts": counts.restarts,
            "refused": node.decoder.mismatch_text,
            "bias_filter": filter_report_json(node.filter_report),
            "battery_mv": health.battery_mv if health is not None else None,
            "clock": node.clock.estimate().as_json(),
        }
    links = {label: _link_json(link) for label, link in recorder.links.items()}
    gnss = {
        label: {
            "fixes": session.decoder.counts.fixes,
            "sentences": session.decoder.counts.sentences,
            "checksum_errors": session.decoder.counts.checksum_errors,
            "unread": session.decoder.counts.unparsed,
        }
        for label, session in recorder.gnss.items()
    }
    for label, topic in recorder.topics.items():
        links[label] = _topic_link_json(topic)
        if isinstance(topic.handler, ImuHandler):
            nodes[label] = _topic_node_json(topic)
        elif isinstance(topic.handler, FixHandler):
            gnss[label] = _topic_gnss_json(topic, topic.handler.fixes)
    return RecordResult(
        file=str(series.path),
        files=tuple(map(str, series.paths)),
        messages_lost=series.messages_lost,
        removed=series.disk_space.removed,
        trouble=series.pause_reason,
        duration=duration,
        messages=messages,
        size=series.size,
        nodes=nodes,
        links=links,
        gnss=gnss,
        odometry=_odometry_json(recorder),
        map=_map_json(recorder),
        faults=recorder.bulkheads.fault_counts(),
    )


def _odometry_json(recorder: Recorder) -> dict[str, Any] | None:
    odometer = recorder.odometry.odometer
    if odometer is None:
        return None
    state = odometer.state
    return {
        "method": "wheel filter",
        "nodes": list(odometer.nodes),
        "poses": odometer.pose_count,
        "distance": odometer.distance,
        "x": state.x if state else 0.0,
        "y": state.y if state else 0.0,
        "heading": state.heading if state else 0.0,
        **recorder.odometry.latency.as_json(),
    }


def _map_json(recorder: Recorder) -> dict[str, Any] | None:
    if not recorder.map.is_active:
        return None
    located = recorder.map.latest
    fields: dict[str, Any] = {"poses": recorder.map.pose_count, **recorder.map.latency.as_json()}
    if located is not None:
        latitude, longitude = located.origin_deg
        x, y = located.position[0].tolist()
        fields |= {
            "latitude_deg": latitude,
            "longitude_deg": longitude,
            "x": x,
            "y": y,
            "heading": float(located.heading[0]),
            "sigma": math.sqrt(float(np.trace(located.pose_covariance[0, :2, :2]))),
        }
    return fields


def _topic_node_json(topic: TopicSession) -> dict[str, Any]:
    return {
        "link": topic.port.label,
        "node_id": None,
        "frames": topic.messages,
        "frames_lost": topic.samples_lost,
        "frames_late": topic.damage[OUT_OF_ORDER],
        "frames_unread": topic.damage[UNDECODABLE],
        "samples": topic.samples,
        "samples_lost": topic.samples_lost,
        "rate_hz": topic.mean_rate(),
        "saturated_batches": 0,
        "gaps": dict(topic.gaps),
        "restarts": 0,
        "refused": None,
        "bias_filter": None,
        "battery_mv": None,
        "clock": topic.clock.sync.estimate().as_json(),
    }


def _topic_gnss_json(topic: TopicSession, fixes: int) -> dict[str, Any]:
    damaged = topic.damage.total()
    return {"fixes": fixes, "sentences": topic.messages, "checksum_errors": 0, "unread": damaged}


def _topic_link_json(topic: TopicSession) -> dict[str, Any]:
    return {
        "where": topic.connection.endpoint,
        "frames": topic.messages,
        "bytes": topic.bytes,
        "frames_damaged": topic.damage.total(),
        "damage": dict(topic.damage),
        "frames_cut": 0,
        "disconnections": topic.connection.disconnections,
        "faults": topic.connection.faults,
        "refused": 0,
        "senders_evicted": 0,
    }


def _link_json(link: LinkSession) -> dict[str, Any]:
    return {
        "where": link.endpoint,
        "frames": link.frames,
        "bytes": link.bytes,
        "frames_damaged": sum(link.damage.values()),
        "damage": dict(link.damage),
        "frames_cut": link.frames_cut,
        "disconnections": link.connection.disconnections,
        "faults": link.connection.faults,
        "refused": link.datagrams_refused + link.senders.frames_refused,
        "senders_evicted": link.senders.senders_evicted,
    }
