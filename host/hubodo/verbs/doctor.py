"""`hubodo doctor`: a board in the hand, looked at step by step; what is wrong, and what to do about it."""

import argparse
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.errors import InputError
from hubodo.flash.board import CONSOLE_BAUD
from hubodo.flash.doctor import Examination, examine

EXAMPLE = "hubodo doctor /dev/ttyACM0 --repl"

_LEAST_S = 3.0
_COLOURS = {"ok": "green", "wrong": "red", "unknown": "yellow"}


@dataclass(frozen=True)
class Diagnosis:
    """What was found on a port."""

    found: Examination

    @property
    def failed(self) -> bool:
        return not self.found.healthy

    def as_json(self) -> dict[str, Any]:
        checks = [result.as_json() for result in self.found.results]
        return {"port": self.found.port, "ok": self.found.healthy, "checks": checks}

    def render(self, console: Console) -> None:
        table = Table("", "check", "", "seen, and what to do", title=f"board on {self.found.port}")
        for number, result in enumerate(self.found.results, 1):
            colour = _COLOURS[result.verdict]
            remedy = f"\n→ {result.remedy}" if result.remedy else ""
            table.add_row(
                str(number), result.check, f"[{colour}]{result.verdict}[/]", f"{result.seen}{remedy}"
            )
        console.print(table)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("port", metavar="PORT", help="serial device of the board")
    parser.add_argument(
        "--repl",
        action="store_true",
        help="interrupt a node that runs: look at its wires and files from within, then start it again",
    )
    parser.add_argument("--seconds", type=float, default=6.0, help="how long to listen (default: 6)")
    parser.add_argument(
        "--baud", type=int, default=CONSOLE_BAUD, help=f"(default: {CONSOLE_BAUD}, a console's)"
    )


def run(args: argparse.Namespace) -> Diagnosis:
    if args.seconds < _LEAST_S:
        raise InputError(f"--seconds {args.seconds:g}: at least {_LEAST_S:g}, or a clock shows nothing")
    with Console(stderr=True).status(f"{args.port}: listening") as status:
        return Diagnosis(
            examine(
                args.port,
                baud=args.baud,
                seconds=args.seconds,
                repl=args.repl,
                note=lambda text: status.update(f"{args.port}: {text}"),
            )
        )
