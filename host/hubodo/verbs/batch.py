"""`hubodo batch`: what another verb does with one log, done with many, on this computer or a Dask cluster."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.errors import InputError
from hubodo.extras import require_extra
from hubodo.fleet.names import CALIBRATION, PRIORS
from hubodo.log.input_limits import memory_limit
from hubodo.progress import progress_line
from hubodo.verbs import VERBS, load
from hubodo.verbs.numbers import whole
from hubodo.verbs.parser import Parser

EXAMPLE = (
    "hubodo batch info drives/ -o fleet/\n"
    "  hubodo batch allan 's3://logs/2026-*/*.mcap' --node all -o fleet/ --scheduler tcp://cluster:8786"
)
ANALYSES = ("info", "fuse", "allan", "warmup", "calibrate", "gap", "report", "export")
_OWN = ("logs", "output", "priors", "scheduler", "workers", "memory_limit")
_OF_EACH_VERB = ("verb", "analysis", "json", "debug", "run")
_OF_COMMAND = ("--json", "--debug")
_NOT_HERE = ("-o", "--output", "--force", "--figure", "--report", "--datasheet")
"""Options of verbs that name what one log's result is written to, or what it is laid beside."""
_OUTPUT = {
    "fuse": "",
    "gap": "",
    "report": "report.html",
    "calibrate": CALIBRATION,
    "warmup": CALIBRATION,
    "export": "tables",
}
"""What a verb writes, within the folder for one log; "" the folder itself."""
_SHOWN = 10


@dataclass(frozen=True)
class BatchDone:
    """What became of the logs. counts: logs by status. errors: of those without a result, log and line."""

    output: str
    analysis: str
    logs: int
    fresh: int
    counts: Mapping[str, int]
    cpu: float
    size: int
    errors: Sequence[tuple[str, str]]

    def as_json(self) -> dict[str, Any]:
        return {
            "output": self.output,
            "analysis": self.analysis,
            "logs": self.logs,
            "fresh": self.fresh,
            **{name: self.counts.get(name, 0) for name in ("done", "refused", "failed")},
            "cpu_s": self.cpu,
            "size_bytes": self.size,
            "errors": [{"log": log, "error": text} for log, text in self.errors],
        }

    def render(self, console: Console) -> None:
        def say(text: str) -> None:
            console.print(text, highlight=False, markup=False, soft_wrap=True)

        counts = ", ".join(f"{count} {status}" for status, count in sorted(self.counts.items()))
        say(f"{self.analysis}: {self.logs} logs, {self.size / 1e9:.3f} GB: {counts}")
        say(f"{self.fresh} done now, {self.cpu:.1f} s of processor for all")
        table = Table("log", "why it has no result")
        for log, text in self.errors[:_SHOWN]:
            table.add_row(log, text)
        if self.errors:
            console.print(table)
        if len(self.errors) > _SHOWN:
            say(f"and {len(self.errors) - _SHOWN} more (--json shows all)")
        say(f"{self.output}/fleet.html, {self.output}/table.parquet")


class _VerbParser(Parser):
    """A verb's own options for many logs; it is loaded when its options are wanted."""

    def __init__(self, *args: Any, of: str | None = None, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._of = of

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self._of is not None:
            of, self._of = self._of, None
            load(of).add_arguments(self)
        return super().parse_known_args(args, namespace)

    def add_argument(self, *names: Any, **how: Any) -> argparse.Action:
        if names[0] in _OF_COMMAND:
            return argparse.Action([], names[0])  # `_add_own` has it
        if names[0] in _NOT_HERE:
            dest = next(name for name in names if name.startswith("--"))[2:]
            self.set_defaults(**{dest: how.get("default")})
            return argparse.Action([], dest)
        if names != ("log",):
            return super().add_argument(*names, **how)
        made = super().add_argument(
            "logs", nargs="+", metavar="LOG", help="logs, folders, globs or URLs of them"
        )
        self.set_defaults(log=how.get("nargs"))
        _add_own(self)
        return made


def _add_own(parser: argparse.ArgumentParser) -> None:
    add = argparse.ArgumentParser.add_argument
    add(
        parser, "-o", "--output", required=True, metavar="OUT", help="folder or URL for table, page and files"
    )
    add(
        parser,
        "--priors",
        action="store_true",
        help=f"of calibrate and warmup: write what is usual among the vehicles to OUT/{PRIORS}",
    )
    group = parser.add_argument_group("where the work is done")
    group.add_argument(
        "--scheduler", metavar="URL", help="of a Dask cluster, as tcp://host:8786 (default: this computer)"
    )
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    group.add_argument(
        "--workers",
        type=whole(1, 1024),
        default=cores,
        metavar="N",
        help="processes here (default: %(default)s)",
    )
    group.add_argument(
        "--memory-limit",
        default="auto",
        metavar="SIZE",
        help="of each process, as 2GB (default: all memory shared out)",
    )
    for option in _OF_COMMAND:
        add(parser, option, action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `hubodo batch VERB`."""
    kinds = parser.add_subparsers(dest="analysis", required=True, metavar="VERB", parser_class=_VerbParser)
    for name in ANALYSES:
        kinds.add_parser(name, of=name, help=VERBS[name], description=f"{VERBS[name]}; for each of many logs")


def run(args: argparse.Namespace) -> BatchDone:
    """Find the logs, examine each, gather."""
    require_extra("batch", "hubodo batch")
    from hubodo.fleet.engine import engine
    from hubodo.fleet.listing import find_logs
    from hubodo.fleet.place import opened, url_of
    from hubodo.fleet.priors import write_priors
    from hubodo.fleet.task import Analysis, read_files
    from hubodo.fleet.workflow import run_batch

    options = {name: value for name, value in vars(args).items() if name not in _OWN + _OF_EACH_VERB}
    if args.analysis == "warmup":
        options["calibration"] = args.priors
    kind = options.get("kind")
    analysis = Analysis(
        f"{args.analysis} {kind}" if kind else args.analysis, options, read_files(options), examine_one
    )
    if args.priors and _OUTPUT.get(args.analysis) != CALIBRATION:
        raise InputError("--priors goes with calibrate and warmup")
    output = url_of(*opened(args.output)).rstrip("/")
    places = find_logs(args.logs, output)
    with progress_line() as show:
        made = run_batch(
            lambda: engine(args.scheduler, args.workers, args.memory_limit), places, analysis, output, show
        )
    if args.priors:
        write_priors(output, made.rows)
    rows = made.rows.select(["log", "status", "error", "cpu", "size"]).to_pydict()
    counts = {status: rows["status"].count(status) for status in sorted(set(rows["status"]))}
    errors = [(log, error) for log, error in zip(rows["log"], rows["error"], strict=True) if error]
    return BatchDone(
        output,
        analysis.verb,
        len(places),
        made.fresh,
        counts,
        sum(cpu or 0.0 for cpu in rows["cpu"]),
        sum(rows["size"]),
        errors,
    )


def examine_one(verb: str, options: Mapping[str, Any], log: Path, folder: Path) -> Mapping[str, Any]:
    """What the verb says of one log, as its `--json`; it writes into the folder. Runs in a worker."""
    name = verb.partition(" ")[0]
    args = argparse.Namespace(**options)
    args.log = [log] if options["log"] else log
    # Without an accepted model warmup refuses to write a file, though it has much to tell.
    writes = name in _OUTPUT and (name != "warmup" or options["calibration"])
    args.output = folder / _OUTPUT[name] if writes else None
    with memory_limit(options.get("max_memory")):
        result = load(name).run(args)
    if result is None:
        raise InputError(f"hubodo {name} has no result")
    made: Mapping[str, Any] = result.as_json()
    return made
