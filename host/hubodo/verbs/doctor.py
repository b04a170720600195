"""`hubodo doctor`: this computer, or a board in the hand, step by step: what is wrong, what to do."""

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hubodo.flash.computer_checks import ComputerCheck, look_at
from hubodo.flash.surroundings import Surroundings
from hubodo.terminal import SafeConsole
from hubodo.verbs.numbers import baud, number
from hubowire.budget import CONSOLE_BAUD

if TYPE_CHECKING:
    from hubodo.flash.doctor import Examination

EXAMPLE = """hubodo doctor                     # this computer: ports, rights, clock, disk, packages, boards
  hubodo doctor /dev/ttyACM0 --repl # the board there, also from within"""

_LEAST_S = 3.0
_COLOURS = {"ok": "green", "warn": "yellow", "bad": "red", "wrong": "red", "unknown": "yellow"}


@dataclass(frozen=True)
class Diagnosis:
    """What was found on a port."""

    found: "Examination"

    @property
    def failed(self) -> bool:
        return not self.found.healthy

    def as_json(self) -> dict[str, Any]:
        checks = [result.as_json() for result in self.found.results]
        return {"port": self.found.port, "ok": self.found.healthy, "checks": checks}

    def render(self, console: Console) -> None:
        table = Table("", "check", "", "seen, and what to do", title=f"board on {self.found.port}")
        for place, result in enumerate(self.found.results, 1):
            colour = _COLOURS[result.verdict]
            remedy = f"\n→ {result.remedy}" if result.remedy else ""
            table.add_row(
                str(place), result.check, f"[{colour}]{result.verdict}[/]", f"{result.seen}{remedy}"
            )
        console.print(table)


@dataclass(frozen=True)
class ComputerDiagnosis:
    """What was found on this computer."""

    findings: tuple[ComputerCheck, ...]

    @property
    def failed(self) -> bool:
        return any(finding.verdict == "bad" for finding in self.findings)

    def as_json(self) -> dict[str, Any]:
        return {"ok": not self.failed, "checks": [finding.as_json() for finding in self.findings]}

    def render(self, console: Console) -> None:
        table = Table.grid(padding=(0, 2))
        table.add_column(no_wrap=True)
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")
        for finding in self.findings:
            remedy = f"\n[bold]→ {escape(finding.remedy)}[/]" if finding.remedy else ""
            colour = _COLOURS[finding.verdict]
            table.add_row(f"[{colour}]{finding.verdict}[/]", finding.check, f"{escape(finding.seen)}{remedy}")
        console.print(table, highlight=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "port",
        metavar="PORT",
        nargs="?",
        help="serial device of a board; without one, this computer is looked at",
    )
    parser.add_argument(
        "--repl",
        action="store_true",
        help="interrupt a node that runs: look at its wires and files from within, then start it again",
    )
    parser.add_argument(
        "--seconds", type=number(_LEAST_S, 3600.0), default=6.0, help="how long to listen (default: 6)"
    )
    parser.add_argument(
        "--baud", type=baud, default=CONSOLE_BAUD, help=f"(default: {CONSOLE_BAUD}, a console's)"
    )


def run(args: argparse.Namespace) -> Diagnosis | ComputerDiagnosis:
    if args.port is None:
        with SafeConsole(stderr=True).status("looking at this computer"):
            return ComputerDiagnosis(tuple(look_at(Surroundings())))
    from hubodo.flash.doctor import examine  # by way of termios, which Windows lacks

    with SafeConsole(stderr=True).status(f"{args.port}: listening") as status:
        return Diagnosis(
            examine(
                args.port,
                baud=args.baud,
                seconds=args.seconds,
                repl=args.repl,
                note=lambda text: status.update(f"{args.port}: {text}"),
            )
        )
