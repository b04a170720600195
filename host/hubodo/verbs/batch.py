"""`hubodo batch`: run another verb on many logs, on this computer or on a Dask cluster."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.errors import InputError
from hubodo.extras import require_extra
from hubodo.fleet.file_names import CALIBRATION_FILE, PRIORS_FILE
from hubodo.log.input_limits import memory_limit
from hubodo.progress import progress_line
from hubodo.verbs import VERBS, load_verb
from hubodo.verbs.numbers import bounded_integer
from hubodo.verbs.parser import Parser

EXAMPLE = (
    "hubodo batch info drives/ -o fleet/\n"
    "  hubodo batch allan 's3://logs/2026-*/*.mcap' --node all -o fleet/ --scheduler tcp://cluster:8786"
)
ANALYSES = ("info", "fuse", "allan", "warmup", "calibrate", "gap", "report", "export")
_NEEDED_MODULES = ("fsspec", "pandas", "pyarrow")
"""Modules needed with or without worker processes; Dask takes seconds to load."""
_QUICK_ANALYSES = ("info", "fuse", "allan", "export")
_MAX_SIZE_WITHOUT_WORKERS = 50_000_000
"""Bytes that `_QUICK_ANALYSES` process in some seconds, as long as worker processes take to start."""
_BATCH_OPTIONS = ("logs", "output", "priors", "scheduler", "workers", "memory_limit")
_COMMON_DESTINATIONS = ("verb", "analysis", "json", "debug", "run", "output_destinations")
_COMMON_OPTIONS = ("--json", "--debug")
_HIDDEN_OPTIONS = ("-o", "--output", "--force", "--figure", "--report", "--datasheet")
"""Options of verbs that `batch` hides: outputs of a single log, and comparisons with other files."""
_OUTPUT_OF_VERB = {
    "fuse": "",
    "gap": "",
    "report": "report.html",
    "calibrate": CALIBRATION_FILE,
    "warmup": CALIBRATION_FILE,
    "export": "tables",
}
"""Output path of each verb inside the folder for one log; "" is the folder itself."""
_MAX_SHOWN_ERRORS = 10


@dataclass(frozen=True)
class BatchResult:
    """The outcome of a batch.

    Attributes
    ----------
    output
        Folder or URL of the results.
    analysis
        The verb that was run.
    n_logs
        Number of logs.
    n_processed
        Number of logs processed in this run; the others were already up to date.
    counts
        Number of logs by status: done, refused, failed.
    cpu_s
        Processor time of all logs, s.
    size_bytes
        Size of all logs, bytes.
    errors
        Log and error line of each log without a result.
    """

    output: str
    analysis: str
    n_logs: int
    n_processed: int
    counts: Mapping[str, int]
    cpu_s: float
    size_bytes: int
    errors: Sequence[tuple[str, str]]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {
            "output": self.output,
            "analysis": self.analysis,
            "logs": self.n_logs,
            "fresh": self.n_processed,
            **{name: self.counts.get(name, 0) for name in ("done", "refused", "failed")},
            "cpu_s": self.cpu_s,
            "size_bytes": self.size_bytes,
            "errors": [{"log": log, "error": text} for log, text in self.errors],
        }

    def render(self, console: Console) -> None:
        """Print the counts, then the first errors."""

        def print_line(text: str) -> None:
            console.print(text, highlight=False, markup=False, soft_wrap=True)

        counts = ", ".join(f"{count} {status}" for status, count in sorted(self.counts.items()))
        print_line(f"{self.analysis}: {self.n_logs} logs, {self.size_bytes / 1e9:.3f} GB: {counts}")
        print_line(f"{self.n_processed} processed now, {self.cpu_s:.1f} s of processor time in total")
        table = Table("log", "error")
        for log, text in self.errors[:_MAX_SHOWN_ERRORS]:
            table.add_row(log, text)
        if self.errors:
            console.print(table)
        if len(self.errors) > _MAX_SHOWN_ERRORS:
            print_line(f"and {len(self.errors) - _MAX_SHOWN_ERRORS} more (--json shows all)")
        print_line(f"{self.output}/fleet.html, {self.output}/table.parquet")


class _VerbParser(Parser):
    """A subparser with the options of one verb, adapted to many logs; the verb is imported on first use."""

    def __init__(self, *args: Any, verb: str | None = None, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._pending_verb = verb

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self._pending_verb is not None:
            verb, self._pending_verb = self._pending_verb, None
            load_verb(verb).add_arguments(self)
            self.set_defaults(output_destinations=())  # files of single logs are written by the workers
        return super().parse_known_args(args, namespace)

    def add_argument(self, *names: Any, **settings: Any) -> argparse.Action:
        if names[0] in _COMMON_OPTIONS:
            return argparse.Action([], names[0])  # `_add_batch_options` adds it
        if names[0] in _HIDDEN_OPTIONS:
            dest = next(name for name in names if name.startswith("--"))[2:]
            self.set_defaults(**{dest: settings.get("default")})
            return argparse.Action([], dest)
        if names != ("log",):
            return super().add_argument(*names, **settings)
        argument = super().add_argument("logs", nargs="+", metavar="LOG", help="logs, folders, globs or URLs")
        self.set_defaults(log=settings.get("nargs"))
        _add_batch_options(self)
        return argument


def _add_batch_options(parser: argparse.ArgumentParser) -> None:
    add = argparse.ArgumentParser.add_argument
    add(
        parser,
        "-o",
        "--output",
        required=True,
        metavar="OUT",
        help="folder or URL for the table, the page and the files",
    )
    add(
        parser,
        "--priors",
        action="store_true",
        help=f"with calibrate and warmup: write the spread over all vehicles as priors to OUT/{PRIORS_FILE}",
    )
    group = parser.add_argument_group("execution")
    group.add_argument(
        "--scheduler", metavar="URL", help="Dask scheduler, such as tcp://host:8786 (default: this computer)"
    )
    cores = _count_cores()
    group.add_argument(
        "--workers",
        type=bounded_integer(1, 1024),
        metavar="N",
        help=f"worker processes on this computer (default: {cores}; none for a few small logs)",
    )
    group.add_argument(
        "--memory-limit",
        default="auto",
        metavar="SIZE",
        help="memory limit of each process, such as 2GB (default: an equal share of all memory)",
    )
    for option in _COMMON_OPTIONS:
        add(parser, option, action="store_true", default=argparse.SUPPRESS, help=argparse.SUPPRESS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo batch VERB`."""
    kinds = parser.add_subparsers(dest="analysis", required=True, metavar="VERB", parser_class=_VerbParser)
    for name in ANALYSES:
        kinds.add_parser(
            name, verb=name, help=VERBS[name], description=f"{VERBS[name]}, for each of many logs"
        )


def run(args: argparse.Namespace) -> BatchResult:
    """Find the logs, run the verb on each, and collect the results in one table.

    Returns
    -------
    BatchResult
        Counts, errors and the folder of the results.

    Raises
    ------
    InputError
        If no log is found, or --priors is given with a verb that writes no calibration.
    """
    require_extra("batch", "hubodo batch", _NEEDED_MODULES)
    from hubodo.fleet.engine import connect_client
    from hubodo.fleet.listing import find_logs
    from hubodo.fleet.priors import write_priors
    from hubodo.fleet.storage import format_url, open_file_system
    from hubodo.fleet.task import Analysis, read_option_files
    from hubodo.fleet.workflow import run_batch

    options = {
        name: value for name, value in vars(args).items() if name not in _BATCH_OPTIONS + _COMMON_DESTINATIONS
    }
    if args.analysis == "warmup":
        options["calibration"] = args.priors
    kind = options.get("kind")
    analysis = Analysis(
        f"{args.analysis} {kind}" if kind else args.analysis, options, read_option_files(options), run_on_log
    )
    if args.priors and _OUTPUT_OF_VERB.get(args.analysis) != CALIBRATION_FILE:
        raise InputError("--priors goes with calibrate and warmup")
    output = format_url(*open_file_system(args.output)).rstrip("/")
    places = find_logs(args.logs, output)
    with progress_line() as show:
        outcome = run_batch(
            lambda unfinished: (
                nullcontext()
                if _needs_no_workers(args, [place.size for place in unfinished])
                else connect_client(args.scheduler, args.workers or _count_cores(), args.memory_limit)
            ),
            places,
            analysis,
            output,
            show,
        )
    if args.priors:
        write_priors(output, outcome.rows)
    rows = outcome.rows.select(["log", "status", "error", "cpu", "size"]).to_pydict()
    counts = {status: rows["status"].count(status) for status in sorted(set(rows["status"]))}
    errors = [(log, error) for log, error in zip(rows["log"], rows["error"], strict=True) if error]
    return BatchResult(
        output,
        analysis.verb,
        len(places),
        outcome.n_examined,
        counts,
        sum(cpu or 0.0 for cpu in rows["cpu"]),
        sum(rows["size"]),
        errors,
    )


def _count_cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _needs_no_workers(args: argparse.Namespace, sizes: Sequence[int]) -> bool:
    """Return True if this process analyses the logs sooner than worker processes would start.

    sizes: sizes of the pending logs, bytes. An option about workers always starts them.
    """
    if args.scheduler is not None or args.workers is not None or args.memory_limit != "auto":
        return False
    return len(sizes) == 1 or (args.analysis in _QUICK_ANALYSES and sum(sizes) <= _MAX_SIZE_WITHOUT_WORKERS)


def run_on_log(verb: str, options: Mapping[str, Any], log: Path, folder: Path) -> Mapping[str, Any]:
    """Run a verb on one log inside a worker process, and return its JSON result.

    verb: name of the verb, with its kind for `calibrate`. options: its parsed options. folder: for its files.
    """
    name = verb.partition(" ")[0]
    args = argparse.Namespace(**options)
    args.log = [log] if options["log"] else log
    # Without an accepted model warmup refuses to write a file, but its JSON result is still useful.
    writes = name in _OUTPUT_OF_VERB and (name != "warmup" or options["calibration"])
    args.force = True  # a result of earlier options is replaced
    args.output = folder / _OUTPUT_OF_VERB[name] if writes else None
    with memory_limit(options.get("max_memory")):
        result = load_verb(name).run(args)
    if result is None:
        raise InputError(f"hubodo {name} has no result")
    summary: Mapping[str, Any] = result.as_json()
    return summary
