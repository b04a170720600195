"""`hubodo doctor`: diagnose this computer, or a connected board, step by step."""

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hubodo.flash.computer import HostComputer
from hubodo.flash.computer_checks import ComputerCheck, check_computer
from hubodo.terminal import SafeConsole
from hubodo.verbs.numbers import baud_rate, bounded_number
from hubowire.budget import CONSOLE_BAUD

if TYPE_CHECKING:
    from hubodo.flash.doctor import Examination

EXAMPLE = """hubodo doctor                     # this computer: ports, permissions, clock, disk, packages
  hubodo doctor /dev/ttyACM0 --repl # the board on that port, also over its MicroPython prompt"""

_MIN_LISTENING_S = 3.0
_VERDICT_COLOURS = {"ok": "green", "warn": "yellow", "bad": "red", "wrong": "red", "unknown": "yellow"}


@dataclass(frozen=True)
class BoardDiagnosis:
    """The diagnosis of the board on one port."""

    examination: "Examination"

    @property
    def failed(self) -> bool:
        """Return True if a check failed."""
        return not self.examination.is_healthy

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        checks = [result.as_json() for result in self.examination.results]
        return {"port": self.examination.port, "ok": self.examination.is_healthy, "checks": checks}

    def render(self, console: Console) -> None:
        """Print one row for each check, with the remedy."""
        table = Table("", "check", "", "observation and remedy", title=f"board on {self.examination.port}")
        results = self.examination.results
        if results[0].verdict == "wrong":  # without a port nothing else could be checked
            results = results[:1]
        for step, result in enumerate(results, 1):
            colour = _VERDICT_COLOURS[result.verdict]
            remedy = f"\n→ {result.remedy}" if result.remedy else ""
            table.add_row(
                str(step), result.check, f"[{colour}]{result.verdict}[/]", f"{result.observation}{remedy}"
            )
        console.print(table)


@dataclass(frozen=True)
class ComputerDiagnosis:
    """The diagnosis of this computer."""

    checks: tuple[ComputerCheck, ...]

    @property
    def failed(self) -> bool:
        """Return True if a check failed."""
        return any(finding.verdict == "bad" for finding in self.checks)

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {"ok": not self.failed, "checks": [finding.as_json() for finding in self.checks]}

    def render(self, console: Console) -> None:
        """Print one row for each check, with the remedy."""
        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True)
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")
        for finding in self.checks:
            remedy = f"\n[bold]→ {escape(finding.remedy)}[/]" if finding.remedy else ""
            colour = _VERDICT_COLOURS[finding.verdict]
            table.add_row(
                f"[{colour}]{finding.verdict}[/]", finding.check, f"{escape(finding.observation)}{remedy}"
            )
        console.print(table, highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo doctor`."""
    parser.add_argument(
        "port",
        metavar="PORT",
        nargs="?",
        help="serial device of a board; without it, this computer is diagnosed",
    )
    parser.add_argument(
        "--repl",
        action="store_true",
        help="interrupt the running firmware, inspect wiring and files over its prompt, then restart it",
    )
    parser.add_argument(
        "--seconds",
        type=bounded_number(_MIN_LISTENING_S, 3600.0),
        default=6.0,
        help="how long to listen (default: 6)",
    )
    parser.add_argument(
        "--baud",
        type=baud_rate,
        default=CONSOLE_BAUD,
        help=f"baud rate (default: {CONSOLE_BAUD}, that of the USB console)",
    )


def run(args: argparse.Namespace) -> BoardDiagnosis | ComputerDiagnosis:
    """Diagnose the board on a port, or this computer if no port is given.

    Returns
    -------
    BoardDiagnosis or ComputerDiagnosis
        The outcome of each check, with a remedy where one failed.

    Raises
    ------
    LinkError
        If the port cannot be opened.
    """
    if args.port is None:
        with SafeConsole(stderr=True).status("checking this computer"):
            return ComputerDiagnosis(tuple(check_computer(HostComputer())))
    from hubodo.flash.doctor import examine  # imports termios, which Windows lacks

    with SafeConsole(stderr=True).status(f"{args.port}: listening") as status:
        return BoardDiagnosis(
            examine(
                args.port,
                baud=args.baud,
                seconds=args.seconds,
                repl=args.repl,
                report_step=lambda text: status.update(f"{args.port}: {text}"),
            )
        )
