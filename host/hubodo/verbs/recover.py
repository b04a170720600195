"""`hubodo recover`: a log cut off mid-write, or damaged, into a whole one."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.log import recover as log_recover
from hubodo.progress import progress_line
from hubodo.verbs.log_options import add_memory_option

EXAMPLE = "hubodo recover drive.mcap -o drive-whole.mcap"


@dataclass(frozen=True)
class RecoverResult:
    """The account of a recovery, for people and for programs."""

    done: log_recover.RecoveryReport

    def as_json(self) -> dict[str, Any]:
        """As `--json` prints it."""
        done = self.done
        return {
            "log": str(done.path),
            "output": str(done.out),
            "was_whole": done.was_complete,
            "messages": done.messages,
            "start_ns": done.start_ns,
            "end_ns": done.end_ns,
            "bytes_read": done.bytes_read,
            "bytes_lost": done.bytes_lost,
            "chunks_kept": done.chunks_kept,
            "chunks_lost": done.chunks_lost,
            "messages_of_unknown_channels": done.unknown_channel_messages,
            "losses": list(done.losses),
        }

    def render(self, console: Console) -> None:
        """Kept, then lost."""
        done = self.done
        lines = [f"{topic}: kept {count} messages" for topic, count in done.messages.items()]
        if done.start_ns is not None and done.end_ns is not None:
            first, last = ((t - done.t_zero_ns) / 1e9 for t in (done.start_ns, done.end_ns))
            lines.append(f"kept t = {first:.3f} s to {last:.3f} s in {done.chunks_kept} chunks")
        lines += [f"lost: {line}" for line in done.losses]
        if done.unknown_channel_messages:
            lines.append(
                f"lost: {done.unknown_channel_messages} messages of channels the file no longer tells about"
            )
        if done.was_complete:
            lines.append("the log was whole; nothing had to be repaired")
        else:
            lines.append(f"lost {done.bytes_lost} of {done.bytes_read} bytes")
        lines.append(f"wrote {done.out}: {sum(done.messages.values())} messages")
        for line in lines:
            console.print(line, highlight=False, markup=False, soft_wrap=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo recover`."""
    parser.add_argument("log", metavar="FILE.mcap", type=Path, help="the damaged log; it is not touched")
    parser.add_argument(
        "-o", "--output", metavar="OUT.mcap", type=Path, required=True, help="the log to write"
    )
    add_memory_option(parser)


def run(args: argparse.Namespace) -> RecoverResult:
    """Rebuild the log."""
    with progress_line() as show:
        return RecoverResult(log_recover.recover_log(args.log, args.output, progress=show))
