"""`hubodo info`: show streams, rates, gaps, losses, versions and health of a log."""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hubodo.errors import HubodoError
from hubodo.fuse.mounting_speed import MountingSpeed, mounting_speeds
from hubodo.ingest.node.bias_filter import describe_filter_row
from hubodo.log.any_log import open_as_mcap, open_source
from hubodo.log.bag import stored_size
from hubodo.log.stream_summary import SampleGap, StreamSummary
from hubodo.log.summary import Summary, summarise, summarise_source
from hubodo.progress import progress_line
from hubodo.verbs.info_lines import health_line, metadata_lines, node_lines
from hubodo.verbs.log_options import (
    LOG_HELP,
    VEHICLE_FILE,
    add_log_options,
    stated_input_format,
    stored_vehicle,
)

EXAMPLE = "hubodo info drive.mcap"

_MAX_SHOWN_EVENTS = 20


@dataclass(frozen=True)
class LogInfo:
    """The summary of a log, and up to which speeds the nodes of its vehicle measure, if it carries one."""

    summary: Summary
    speeds: tuple[MountingSpeed, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result; times are in s since t = 0 unless the key ends in `_ns`."""
        s = self.summary
        return {
            "log": str(s.path),
            "size_bytes": s.size,
            "library": s.library,
            "profile": s.profile,
            "complete": s.complete,
            "start_ns": s.start_ns,
            "duration": s.duration,
            "messages": sum(stream.messages for stream in s.streams),
            "streams": [_stream_json(stream) for stream in s.streams],
            "gaps": [_gap_json(gap) for gap in s.gaps],
            "events": [
                {
                    "t": s.seconds(event.t_ns),
                    "t_ns": event.t_ns,
                    "kind": event.kind,
                    "source": event.source,
                    "text": event.text,
                    "data": dict(event.data),
                }
                for event in s.events
            ],
            "losses": [asdict(loss) for loss in s.losses],
            "health": {node: dict(values) for node, values in s.health.items()},
            "bias_filter": {node: _filter_json(row) for node, row in s.bias_filters.items()},
            "metadata": dict(s.metadata),
            "topics": dict(s.roles),
            "attachments": dict(s.attachments),
            "speeds": [speed.as_json() for speed in self.speeds],
            "damaged": s.damaged,
            "warnings": list(s.warnings),
        }

    def render(self, console: Console) -> None:
        """Print heading, streams, gaps, events, health, metadata and warnings; empty parts are omitted."""
        s = self.summary
        print_line = _plain_printer(console)
        state = "complete" if s.complete else "not closed"
        state += f", {s.damaged} damaged places" if s.damaged else ""
        writer = f", written by {s.library}" if s.library else ""
        print_line(f"{s.path}: {s.size} bytes, {state}, {s.duration:.3f} s{writer}")
        if s.start_ns:
            print_line(f"t = 0 is {datetime.fromtimestamp(s.start_ns / 1e9, UTC).isoformat()}")
        _print_clock(s, print_line)
        console.print(_stream_table(s))
        if s.roles:
            print_line("read as: " + ", ".join(f"{name} = {topic}" for name, topic in s.roles.items()))
        _print_gaps(s, print_line)
        _print_losses(s, print_line)
        _print_events(s, print_line)
        for line in node_lines(s.metadata):
            print_line(line)
        for speed in self.speeds:
            print_line(speed.description)
        for node, values in s.health.items():
            print_line(health_line(node, values))
        for node, row in s.bias_filters.items():
            print_line(f"bias filter of {node} at t = {row['t']:.3f} s: {describe_filter_row(row)}")
        for line in metadata_lines(s.metadata):
            print_line(line)
        for name, size in s.attachments.items():
            print_line(f"attachment {name}: {size} bytes")
        for line in s.warnings:
            print_line(f"warning: {line}")


def _plain_printer(console: Console) -> Any:
    return lambda text: console.print(text, highlight=False, markup=False, soft_wrap=True)


def _print_clock(s: Summary, print_line: Any) -> None:
    """Print when the wall clock of the recording computer deviated from UTC."""
    state, correction = s.metadata.get("clock.state", ""), s.metadata.get("clock.utc_minus_log_s", "")
    if state in ("unset", "unsynchronised"):
        print_line(f"the computer's clock was {state}: dates and times of day in this log may be wrong")
    if correction and float(correction):
        print_line(f"the computer's clock was set while recording: UTC is t {float(correction):+.3f} s")


def _stream_table(s: Summary) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("topic", "type"):
        table.add_column(heading, no_wrap=True)
    for heading in ("messages", "Hz", "period ms", "jitter ms", "longest ms", "gaps", "missing"):
        table.add_column(heading, justify="right", no_wrap=True)
    for stream in s.streams:
        sampled = stream.period is not None
        table.add_row(
            escape(stream.topic),
            escape(stream.schema.rpartition("/")[2] or "json"),
            str(stream.messages),
            f"{stream.rate:.2f}" if stream.rate else "",
            f"{1e3 * stream.period:.4f}" if stream.period is not None else "",
            f"{1e3 * stream.jitter:.4f}" if stream.jitter is not None else "",
            f"{1e3 * stream.longest:.3f}" if stream.longest is not None else "",
            str(len(stream.gaps)) if sampled else "",
            str(stream.missing) if sampled else "",
        )
    return table


def _print_gaps(s: Summary, print_line: Any) -> None:
    if not s.gaps:
        return
    causes = Counter(gap.cause for gap in s.gaps)
    print_line(f"{len(s.gaps)} gaps, {sum(gap.missing for gap in s.gaps)} samples missing:")
    for cause, count in causes.most_common():
        missing = sum(gap.missing for gap in s.gaps if gap.cause == cause)
        print_line(f"  {count} times {missing} samples: {cause}")
    longest = sorted(s.gaps, key=lambda gap: -gap.duration)[:_MAX_SHOWN_EVENTS]
    for gap in sorted(longest, key=lambda gap: gap.t):
        print_line(
            f"  t = {gap.t:.3f} s {gap.topic}: {gap.duration:.4f} s, {gap.missing} samples: {gap.cause}"
        )
    if len(s.gaps) > _MAX_SHOWN_EVENTS:
        print_line(f"  and {len(s.gaps) - _MAX_SHOWN_EVENTS} shorter ones (--json shows all)")


def _print_losses(s: Summary, print_line: Any) -> None:
    if s.losses:
        print_line("recorded losses:")
    for loss in s.losses:
        amount = f"{loss.samples} samples" + (f" and {loss.unknown} uncounted gaps" if loss.unknown else "")
        where = f"{loss.node} {loss.stream}".strip()
        total = f"{loss.frames} frames in {loss.gaps} gaps of {loss.duration:.3f} s"
        print_line(f"  {where}: {amount}, {total}: {loss.cause}")


def _print_events(s: Summary, print_line: Any) -> None:
    shown_events = [event for event in s.events if event.kind not in ("health", "gap")]
    if not shown_events:
        return
    kinds = Counter(event.kind for event in shown_events)
    print_line(
        f"{len(shown_events)} events: " + ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    )
    for event in shown_events[:_MAX_SHOWN_EVENTS]:
        is_named = event.text.startswith(f"{event.source}:")
        source = f"{event.source}: " if event.source and not is_named else ""
        print_line(f"  t = {s.seconds(event.t_ns):.3f} s {event.kind}: {source}{event.text}")
    if len(shown_events) > _MAX_SHOWN_EVENTS:
        print_line(f"  and {len(shown_events) - _MAX_SHOWN_EVENTS} later ones (--json shows all)")


def _filter_json(row: Mapping[str, float]) -> dict[str, Any]:
    integers = ("state", "samples", "saturations")
    return {
        name: None if not math.isfinite(value) else int(value) if name in integers else value
        for name, value in row.items()
    }


def _stream_json(stream: StreamSummary) -> dict[str, Any]:
    return {
        "topic": stream.topic,
        "schema": stream.schema,
        "messages": stream.messages,
        "first": stream.first,
        "last": stream.last,
        "rate": stream.rate,
        "period": stream.period,
        "jitter": stream.jitter,
        "longest": stream.longest,
        "gaps": len(stream.gaps),
        "missing": stream.missing,
    }


def _gap_json(gap: SampleGap) -> dict[str, Any]:
    return {
        "topic": gap.topic,
        "t": gap.t,
        "duration": gap.duration,
        "missing": gap.missing,
        "cause": gap.cause,
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo info`."""
    parser.add_argument("log", metavar="LOG", type=Path, help=LOG_HELP)
    add_log_options(parser)


def run(args: argparse.Namespace) -> LogInfo:
    """Summarise the log.

    Returns
    -------
    LogInfo
        Streams, gaps, losses, events, health and metadata.

    Raises
    ------
    LogError
        If the file is no log that can be read.
    """
    form = stated_input_format(args, needed=())
    with progress_line() as show, open_source(args.log) as source:
        if source is not None:
            return _with_speeds(args.log, summarise_source(source, form.topic_selection, progress=show))
    with progress_line() as show, open_as_mcap(args.log, form) as file:
        summary = summarise(file, progress=show)
    # A converted log is a temporary file, which the user never named.
    warnings = tuple(line.replace(f"{file}: ", f"{args.log}: ") for line in summary.warnings)
    summary = replace(summary, path=args.log, warnings=warnings)
    if file != args.log:
        summary = replace(summary, library="", size=stored_size(args.log))
    return _with_speeds(args.log, summary)


def _with_speeds(log: Path, summary: Summary) -> LogInfo:
    if VEHICLE_FILE not in summary.attachments and not (log / VEHICLE_FILE).is_file():
        return LogInfo(summary)
    try:
        vehicle = stored_vehicle(log)
    except HubodoError:  # a damaged vehicle file is named where it is needed
        return LogInfo(summary)
    return LogInfo(summary, tuple(mounting_speeds(vehicle, summary.metadata)))
