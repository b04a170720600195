"""`hubodo recover`: repair a log that is truncated or damaged."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.log import recover as log_recover
from hubodo.progress import progress_line
from hubodo.verbs.log_options import add_memory_option
from hubodo.verbs.outputs import add_force_option

EXAMPLE = "hubodo recover drive.mcap -o repaired.mcap"


@dataclass(frozen=True)
class RecoverResult:
    """The outcome of a repair."""

    recovery: log_recover.RecoveryReport

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        recovery = self.recovery
        return {
            "log": str(recovery.path),
            "output": str(recovery.out),
            "was_whole": recovery.was_complete,
            "messages": recovery.messages,
            "start_ns": recovery.start_ns,
            "end_ns": recovery.end_ns,
            "bytes_read": recovery.bytes_read,
            "bytes_lost": recovery.bytes_lost,
            "chunks_kept": recovery.chunks_recovered,
            "chunks_lost": recovery.chunks_lost,
            "messages_of_unknown_channels": recovery.unknown_channel_messages,
            "losses": list(recovery.losses),
        }

    def render(self, console: Console) -> None:
        """Print what was recovered, then what was lost."""
        recovery = self.recovery
        lines = [f"{topic}: recovered {count} messages" for topic, count in recovery.messages.items()]
        if recovery.start_ns is not None and recovery.end_ns is not None:
            first, last = ((t - recovery.t_zero_ns) / 1e9 for t in (recovery.start_ns, recovery.end_ns))
            lines.append(f"recovered t = {first:.3f} s to {last:.3f} s in {recovery.chunks_recovered} chunks")
        lines += [f"lost: {line}" for line in recovery.losses]
        if recovery.unknown_channel_messages:
            lines.append(f"lost: {recovery.unknown_channel_messages} messages of undescribed channels")
        if recovery.was_complete:
            lines.append("the log was complete; nothing had to be repaired")
        else:
            lines.append(f"lost {recovery.bytes_lost} of {recovery.bytes_read} bytes")
        lines.append(f"wrote {recovery.out}: {sum(recovery.messages.values())} messages")
        for line in lines:
            console.print(line, highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo recover`."""
    parser.add_argument("log", metavar="FILE.mcap", type=Path, help="damaged log; it is not modified")
    parser.add_argument("-o", "--output", metavar="OUT.mcap", type=Path, required=True, help="log to write")
    add_memory_option(parser)
    add_force_option(parser, "output")


def run(args: argparse.Namespace) -> RecoverResult:
    """Rebuild the log.

    Returns
    -------
    RecoverResult
        Messages by topic that were recovered, and what was lost.

    Raises
    ------
    LogError
        If nothing of the file can be recovered.
    """
    with progress_line() as show:
        return RecoverResult(log_recover.recover_log(args.log, args.output, progress=show))
