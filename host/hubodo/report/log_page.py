"""Page of one log: content, losses, sensors, drive, and what the log does not contain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from hubodo.calibration.apply import AppliedCalibration, apply_calibration
from hubodo.calibration.file import Calibration, find_node_serial
from hubodo.calibration.parameter_table import format_with_sigma
from hubodo.log.health_quantities import describe_health
from hubodo.log.summary import Summary
from hubodo.pages.page import PageTable, Section, render_page
from hubodo.recording import Recording
from hubodo.report.bias_filter import bias_filter_section
from hubodo.report.drive_sections import drive_sections
from hubodo.report.log_sensors import report_sensors
from hubodo.vehicle import Vehicle

_MAX_PAGE_ROWS = 40


@dataclass(frozen=True)
class LogPage:
    """The page of one log.

    Attributes:
        html: the page.
        facts: findings, one line each.
        missing: results that the log does not allow, with the reasons, one line each.
    """

    html: str
    facts: tuple[str, ...]
    missing: tuple[str, ...]


def log_page(
    name: str,
    recording: Recording,
    summary: Summary | None,
    *,
    vehicle: Vehicle | None = None,
    calibration: Calibration | None = None,
    calibration_from: str = "",
    gravity: float = 9.80665,
) -> LogPage:
    """Return the page of a log.

    summary: None for a CSV folder, which has no messages. calibration_from: source of the calibration, for
    the text. gravity: local gravity, m/s². Raises CalibrationError if the calibration is for other nodes.
    """
    facts: list[str] = []
    missing: list[str] = []
    losses = _losses(summary, missing)
    sections = [
        _folded(section) for section in (_content(recording, summary, missing), *_events(recording, summary))
    ]
    applied = _applied(recording, calibration)
    sections.append(_calibration(recording, calibration, calibration_from, applied, missing))
    drive_facts: list[str] = []
    drive = drive_sections(name, recording, vehicle, applied, drive_facts, missing)
    for node, table in recording.nodes.items():
        report = report_sensors(node, table, recording.events, recording.t_zero_ns, gravity)
        sections += [_folded(section) for section in report.sections]
        facts += report.facts
        missing += report.missing
        if node not in recording.bias_filters:
            missing.append(f"{node}: bias of the node's own filter: not in the log")
            continue
        section, line = bias_filter_section(node, recording.bias_filters[node])
        (missing if section is None else facts).append(line)
        sections += [] if section is None else [_folded(section)]
    missing.append(
        "north: the log contains a turntable record, which hubodo north evaluates"
        if recording.table is not None
        else "north: no turntable record (table.csv); see hubodo north"
    )
    findings = Section("Findings", advice=facts)
    absent = Section(
        "Not available from this log",
        "Each with the reason; everything else was evaluated.",
        advice=missing,
        is_folded=True,
    )
    return LogPage(
        render_page(
            f"Log {name}",
            _lead(recording, summary, drive_facts),
            [*drive, findings, *losses, *sections, absent],
        ),
        (*drive_facts, *facts),
        tuple(missing),
    )


def _folded(section: Section) -> Section:
    return replace(section, is_folded=True)


def _lead(recording: Recording, summary: Summary | None, drive_facts: Sequence[str]) -> str:
    """Return the answer in one paragraph: the drive and its error if there is one, duration, gaps."""
    tables = [table.t for table in recording.nodes.values() if len(table)]
    duration = max((t[-1] for t in tables), default=0.0) - min((t[0] for t in tables), default=0.0)
    names = " and ".join(recording.nodes) or "no node"
    gaps = 0 if summary is None else len(summary.gaps)
    losses = 0 if summary is None else sum(gap.missing for gap in summary.gaps)
    text = f"{duration:.1f} s of samples from {names}"
    if summary is not None:
        text += f", {gaps} gaps with {losses} samples missing" if gaps else ", no gap"
        text += "" if summary.complete else "; the file was not closed"
    drive = [line[0].upper() + line[1:] + ". " for line in drive_facts]
    return "".join(drive) + text + "."


def _content(recording: Recording, summary: Summary | None, missing: list[str]) -> Section:
    tables, text = [], ""
    if summary is None:
        missing.append("arrival times, links and events: a CSV folder does not contain them")
        rows = [
            (name, str(len(table)), f"{table.t[0]:.3f}", f"{table.t[-1]:.3f}")
            if len(table)
            else (name, "0", "", "")
            for name, table in recording.files().items()
        ]
        tables.append(PageTable(("file", "rows", "from, s", "to, s"), rows))
    else:
        start = (
            datetime.fromtimestamp(summary.start_ns / 1e9, UTC).isoformat() if summary.start_ns else "unknown"
        )
        text = f"{summary.size / 1e6:.2f} MB, {summary.duration:.2f} s; t = 0 is {start}. "
        text += f"Written by {summary.library}."
        tables.append(
            PageTable(
                ("topic", "messages", "rate, Hz", "jitter, ms", "longest, ms", "gaps", "missing"),
                [
                    (
                        stream.topic,
                        str(stream.messages),
                        "" if stream.rate is None else f"{stream.rate:.2f}",
                        "" if stream.jitter is None else f"{1e3 * stream.jitter:.3f}",
                        "" if stream.longest is None else f"{1e3 * stream.longest:.2f}",
                        "" if stream.period is None else str(len(stream.gaps)),
                        "" if stream.period is None else str(stream.missing),
                    )
                    for stream in summary.streams
                ],
            )
        )
    nodes: list[tuple[str, ...]] = []
    for name, table in recording.nodes.items():
        metadata = {
            key: recording.metadata.get(f"node.{name}.{key}", "") for key in ("firmware", "rate_hz", "parts")
        }
        span = "none"
        if "temperature" in table and np.isfinite(table["temperature"]).any():
            span = f"{np.nanmin(table['temperature']):.1f} to {np.nanmax(table['temperature']):.1f}"
        serial = find_node_serial(recording.metadata, name) or "not known"
        nodes.append((name, serial, metadata["firmware"], metadata["rate_hz"], metadata["parts"], span))
    heading = ("node", "serial", "firmware", "nominal Hz", "parts", "temperature, °C")
    tables.append(PageTable(heading, nodes))
    for warning in recording.warnings:
        text += f" Warning: {warning}."
    return Section("Content of the log", text, tables)


def _losses(summary: Summary | None, missing: list[str]) -> list[Section]:
    if summary is None:
        return []
    longest = sorted(summary.gaps, key=lambda gap: -gap.duration)[:_MAX_PAGE_ROWS]
    rows = [
        (f"{gap.t:.3f}", gap.topic, f"{gap.duration:.4f}", str(gap.missing), gap.cause)
        for gap in sorted(longest, key=lambda gap: gap.t)
    ]
    unexplained = sum(gap.cause.startswith("not explained") for gap in summary.gaps)
    text = f"{len(summary.gaps)} gaps, {sum(gap.missing for gap in summary.gaps)} samples missing"
    text += f", {unexplained} not explained by any event." if summary.gaps else "."
    if len(summary.gaps) > _MAX_PAGE_ROWS:
        text += f" The {_MAX_PAGE_ROWS} longest are shown."
    tables = [PageTable(("t, s", "topic", "duration, s", "samples", "cause"), rows)] if rows else []
    if summary.losses:
        losses = [
            (loss.node, loss.stream, loss.cause, str(loss.gaps), str(loss.frames), str(loss.samples))
            for loss in summary.losses
        ]
        tables.append(PageTable(("node", "stream", "cause", "gaps", "frames lost", "samples lost"), losses))
    if summary.health:
        tables.append(_health_table(summary.health))
    else:
        missing.append("health of the nodes: the log contains no health report")
    return [Section("Gaps and losses", text, tables)]


def _health_table(health: Mapping[str, Mapping[str, Any]]) -> PageTable:
    """Return the last health report of each node, one column per node, values with units."""
    described = {
        node: {name: text for _, name, text in describe_health(values)} for node, values in health.items()
    }
    names = dict.fromkeys(name for values in described.values() for name in values)
    rows = [(name, *(values.get(name, "") for values in described.values())) for name in names]
    return PageTable(("last health report", *described), rows)


def _events(recording: Recording, summary: Summary | None) -> list[Section]:
    shown = [event for event in recording.events if event.kind not in ("gap", "health")]
    if summary is None or not shown:
        return []
    rows = [
        (f"{summary.seconds(event.t_ns):.3f}", event.kind, event.source, event.text)
        for event in shown[:_MAX_PAGE_ROWS]
    ]
    text = f"{len(shown)} events" + (
        f", the first {_MAX_PAGE_ROWS} shown." if len(shown) > _MAX_PAGE_ROWS else "."
    )
    return [Section("Events", text, [PageTable(("t, s", "kind", "source", "text"), rows)])]


def _applied(recording: Recording, calibration: Calibration | None) -> AppliedCalibration | None:
    if calibration is None:
        return None
    return apply_calibration(
        recording.nodes,
        calibration,
        metadata=recording.metadata,
        events=recording.events,
        t_zero_ns=recording.t_zero_ns,
    )


def _calibration(
    recording: Recording,
    calibration: Calibration | None,
    source: str,
    applied: AppliedCalibration | None,
    missing: list[str],
) -> Section:
    if calibration is None or applied is None:
        missing.append("calibration: none in the log and none given; the samples are uncalibrated")
        return Section("Calibration in use", "None.")
    parts = [
        *((name, node.effects) for name, node in calibration.nodes.items()),
        ("vehicle", calibration.vehicle),
    ]
    rows = [
        (
            name,
            effect,
            ", ".join(f"{key} {format_with_sigma(q.value, q.sigma)}" for key, q in entry.parameters.items()),
            "" if entry.temperature is None else f"{entry.temperature[0]:.1f} to {entry.temperature[1]:.1f}",
            f"{entry.date} {entry.method}",
        )
        for name, effects in parts
        for effect, entry in effects.items()
    ]
    for name in recording.nodes:
        if name not in calibration.nodes:
            missing.append(f"{name}: calibration: the file does not contain this node")
    text = f"From {source}. Applied to the input of the odometry; the noise below is that of the raw samples."
    text += "".join(f" {line}." for line in applied.warnings)
    return Section(
        "Calibration in use",
        text,
        [PageTable(("node", "effect", "values", "temperature, °C", "date and method"), rows)],
    )
