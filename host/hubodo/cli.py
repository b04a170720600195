"""The `hubodo` command: parses the command line, runs one verb, prints its result and sets the exit code."""

from __future__ import annotations

import argparse
import errno
import io
import itertools
import os
import stat
import sys
import time
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from hubodo.errors import CalibrationError, ConfigError, HubodoError, InputError, LogError, WireMismatch
from hubodo.ingest.stop_signals import exit_after_timeout, exit_on_ctrl_c
from hubodo.log.input_limits import memory_limit
from hubodo.safe_text import json_text, printable
from hubodo.unit_systems import display_units
from hubodo.verbs import VERBS, load_verb
from hubodo.verbs.outputs import replace_outputs
from hubodo.verbs.parser import EXIT_REFUSED, Parser, UsageError
from hubodo.version import __version__

if TYPE_CHECKING:
    from rich.console import Console

EXIT_OK, EXIT_FAILED, EXIT_INTERRUPTED = 0, 1, 130
_REFUSED_INPUT_ERRORS = (InputError, ConfigError, LogError, CalibrationError, WireMismatch)


class Result(Protocol):
    """The result of a verb: a frozen dataclass that provides both the table and `--json`."""

    def as_json(self) -> dict[str, Any]: ...

    def render(self, console: Console) -> None: ...


def _reports_failure(result: Result | None) -> bool:
    """Return True if the verb ran but its result reports a failure, which sets exit code 1."""
    return bool(getattr(result, "failed", False))


def _normalise_option(word: str) -> str:
    """Return an option with hyphens (`--latitude-deg` for `--latitude_deg`); return other words unchanged."""
    option, equals, value = word.partition("=")
    return option.replace("_", "-") + equals + value if word.startswith("--") else word


def _expand_help(words: list[str]) -> list[str]:
    """Return the options that an empty line, `help`, `help VERB` and `version` stand for; else the words."""
    if not words:
        return ["--help"]
    if words == ["version"]:
        return ["--version"]
    return [*words[1:], "--help"] if words[0] == "help" else words


def build_parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser for a command line: all verbs by name, and the options of the verb it names.

    If the first word is a verb, the parser has no others, as they take milliseconds. Every verb accepts
    `--json` and `--debug`.
    """
    requested = next((word for word in words if word in VERBS), None)
    common = Parser(add_help=False)
    common.add_argument("--json", action="store_true", help="print the result as one JSON object")
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser = Parser(prog="hubodo", description="Odometry from inertial sensors on wheel hubs.")
    parser.add_argument("-V", "--version", action="version", version=f"hubodo {__version__}")
    commands = parser.add_subparsers(
        title="verbs", dest="verb", metavar="VERB", required=True, help="hubodo VERB --help shows its options"
    )
    for verb, summary in VERBS.items():
        if verb != requested:
            if requested not in words[:1]:
                commands.add_parser(verb, help=summary)
            continue
        module = load_verb(verb)
        command = commands.add_parser(
            verb,
            parents=[common],
            help=summary,
            description=summary,
            epilog=f"example:\n  {module.EXAMPLE}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code: 0 success, 1 failure, 2 refused input, 130 interrupted."""
    # BLAS threads slow down the small matrices here; the variable is read when the library loads.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _prepare_standard_streams()
    if argv is None and not sys.warnoptions:
        # NumPy warnings about NaN are for developers; a verb reports what it could not compute.
        warnings.simplefilter("ignore", RuntimeWarning)
    if "_ARGCOMPLETE" in os.environ:  # the shell requests completions
        from hubodo.verbs.completers import complete_command, typed_words

        complete_command(build_parser(typed_words()))
    try:
        words = [_normalise_option(word) for word in (sys.argv[1:] if argv is None else argv)]
        words = _expand_help(words)
        with exit_on_ctrl_c():
            args = build_parser(words).parse_args(words)
    except UsageError as error:
        _print_error(error.text, error.text, EXIT_REFUSED, as_json=_wants_json_log(words))
        return EXIT_REFUSED
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else EXIT_REFUSED
    try:
        with display_units(getattr(args, "units", None)):
            with memory_limit(getattr(args, "max_memory", None)), replace_outputs(args):
                result: Result | None = args.run(args)
            code = EXIT_FAILED if _reports_failure(result) else EXIT_OK
            if result is not None:
                with exit_after_timeout(getattr(result, "OUTPUT_DEADLINE", None), code):
                    _print_unless_closed(result, as_json=args.json)
        return code
    except BrokenPipeError:
        # The reader of the output (head, less) has exited.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    except _REFUSED_INPUT_ERRORS as error:
        return _report_error(args, str(error), EXIT_REFUSED)
    except HubodoError as error:
        return _report_error(args, str(error), EXIT_FAILED)
    except KeyboardInterrupt as stop:
        text = str(stop) or "nothing more was written"
        return _report_error(args, f"interrupted; {text}", EXIT_INTERRUPTED)
    except NotADirectoryError as error:
        text = f"{error.filename}: a part of this path is a file, not a folder; name another path"
        return _report_error(args, text, EXIT_REFUSED)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _report_error(
            args, f"{where}{error.strerror or error}; check the path, permissions and disk space", EXIT_FAILED
        )
    except MemoryError:
        text = "not enough memory; use a part of the log, or close other programs"
        return _report_error(args, text, EXIT_FAILED)
    except Exception as error:  # noqa: BLE001 - the last resort: no traceback for users
        text = f"{type(error).__name__}: {error}; this is a defect of hubodo, please report it with --debug"
        return _report_error(args, text, EXIT_FAILED)


def _prepare_standard_streams() -> None:
    """Escape characters that the encoding of a terminal or a pipe lacks, instead of failing.

    Closed standard streams are opened on the null device, so that no log file gets their descriptors.
    """
    if os.name == "posix":
        while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
            pass
        os.close(descriptor)
    sys.stdout = sys.stdout or Path(os.devnull).open("w")  # noqa: SIM115 open as long as the process
    sys.stderr = sys.stderr or Path(os.devnull).open("w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _print_unless_closed(result: Result, *, as_json: bool) -> None:
    """Print a result; ignore a terminal that was closed in the meantime."""
    try:
        _print_result(result, as_json=as_json)
    except OSError as error:
        fd = sys.stdout.fileno()
        if error.errno != errno.EIO or not stat.S_ISCHR(os.fstat(fd).st_mode):
            raise
        # At exit the interpreter flushes the buffer, which would fail and set exit code 120.
        os.dup2(os.open(os.devnull, os.O_WRONLY), fd)


def _print_result(result: Result, *, as_json: bool) -> None:
    if as_json:
        print(json_text(result.as_json()))
    else:
        from hubodo.terminal import SafeConsole  # the import takes 0.1 s, and only tables need it

        # Piped output has no width of its own; 80 columns would cut the tables.
        result.render(SafeConsole() if sys.stdout.isatty() else SafeConsole(width=160))
    sys.stdout.flush()


def _report_error(args: argparse.Namespace, text: str, code: int) -> int:
    line = printable(" ".join(text.split()))
    as_json = getattr(args, "log_format", None) == "json"
    if args.debug and not as_json:
        traceback.print_exc()
    details = {"traceback": traceback.format_exc()} if args.debug else {}
    _print_error(f"hubodo {args.verb}: {line}", line, code, as_json=as_json, details=details)
    return code


def _print_error(
    text: str, line: str, code: int, *, as_json: bool, details: dict[str, Any] | None = None
) -> None:
    """Print one line on stderr: the text, or a JSON object with `line`."""
    if as_json:
        from hubodo.ingest.live.view import format_json_line

        text = format_json_line(
            time.time_ns(), "error", "failed", line, {"exit_code": code, **(details or {})}
        )
    print(text, file=sys.stderr)


def _wants_json_log(words: Sequence[str]) -> bool:
    """Return True if a command line that could not be parsed requests JSON log lines."""
    return "--log-format=json" in words or ("--log-format", "json") in itertools.pairwise(words)


if __name__ == "__main__":
    sys.exit(main())
