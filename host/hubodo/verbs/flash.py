"""`hubodo flash`: compile the firmware, copy it to a board or many, prove what each holds and what runs."""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.calibration.file import read_calibration
from hubodo.errors import InputError
from hubodo.flash.fleet import BoardFailed, Fleet, each, found_ports, orders, read_fleet
from hubodo.flash.image import firmware_folder
from hubodo.flash.install import Flashed, RolledBack, install, roll_back
from hubodo.flash.order import Order, node_id, settings_of
from hubodo.ingest.link.keys import KeyRing
from hubodo.terminal import SafeConsole
from hubowire import node_name

EXAMPLE = (
    "hubodo flash /dev/ttyACM0 --node left\n  hubodo flash --all --fleet fleet.toml\n"
    "  hubodo flash /dev/ttyACM0 --set link=udp --set ssid=net --set password=... --set host=laptop.local "
    "--key-file keys.toml\n  hubodo flash /dev/ttyACM0 --roll-back"
)


@dataclass(frozen=True)
class OneBoard:
    """The result of one port."""

    board: Flashed | RolledBack

    def as_json(self) -> dict[str, Any]:
        return self.board.as_json()

    def render(self, console: Console) -> None:
        table = Table(title=f"running on {self.board.port}", show_header=False)
        for key, value in self.as_json().items():
            if key == "copied":
                value = ", ".join(value) or "nothing: all files were there"
            elif key == "calibrated":
                value = ", ".join(f"{name} {setting}" for name, setting in value.items()) or "-"
            table.add_row(key, str(value))
        console.print(table)
        if isinstance(self.board, RolledBack) and self.board.other_version:
            console.print(
                "this host is of another version: install the hubodo that flashed it, or flash anew"
            )


@dataclass(frozen=True)
class ManyBoards:
    """The result of a fleet; `failed` where a board was not done."""

    fleet: Fleet

    @property
    def failed(self) -> bool:
        return self.fleet.failed

    def as_json(self) -> dict[str, Any]:
        return self.fleet.as_json()

    def render(self, console: Console) -> None:
        table = Table("port", "node", "serial", "firmware", "what was done", title="boards")
        for board in self.fleet.boards:
            if isinstance(board, BoardFailed):
                table.add_row(board.port, "", "", "", ("" if board.left else "FAILED: ") + board.error)
                continue
            told = board.as_json()
            done = "rolled back" if isinstance(board, RolledBack) else f"{len(board.copied)} files copied"
            table.add_row(board.port, node_name(board.node), told.get("serial", ""), told["firmware"], done)
        console.print(table)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("ports", nargs="*", metavar="PORT", help="serial devices of boards")
    parser.add_argument("--all", action="store_true", help="every USB port that a board may be on")
    parser.add_argument(
        "--fleet",
        type=Path,
        metavar="TOML",
        help='who is who: [nodes] with lines serial = "left"; boards that it does not name are left alone',
    )
    parser.add_argument("--node", help="left, right, frame or a number from 1 to 254 (default: as it is)")
    parser.add_argument("--rate-hz", type=int, help="sample rate (default: as it is)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any setting of firmware/README.md, such as link=udp or rest_after_s=60; repeatable",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="TOML",
        help="from `hubodo calibrate`: bias, warm-up and filter gain for the node (default: as they are)",
    )
    parser.add_argument(
        "--key-file",
        type=Path,
        metavar="TOML",
        help="keys for UDP by serial: the board gets its own, a new one where it has none; also for "
        "`hubodo record`",
    )
    parser.add_argument(
        "--roll-back", action="store_true", help="run what ran before the last flashing; settings stay"
    )


def run(args: argparse.Namespace) -> OneBoard | ManyBoards:
    if bool(args.ports) == args.all:
        raise InputError("name ports such as /dev/ttyACM0, or --all for every board that is plugged in")
    fleet = read_fleet(args.fleet) if args.fleet is not None else None
    many = args.all or len(args.ports) > 1 or fleet is not None
    order = _order(args, many)
    ports = found_ports() if args.all else args.ports
    note = SafeConsole(stderr=True)
    with note.status("looking") as status:

        def do(port: str) -> Flashed | RolledBack:
            if args.roll_back:
                return roll_back(port, status.update)
            return install(port, orders(order, fleet), firmware_folder(), status.update)

        if not many:
            return OneBoard(do(args.ports[0]))
        return ManyBoards(each(ports, do))


def _order(args: argparse.Namespace, many: bool) -> Order:
    settings = settings_of(args.set)
    if args.node is not None:
        if many:
            raise InputError("--node is for one board; name many with --fleet TOML")
        settings["node_id"] = node_id(args.node)
    if args.rate_hz is not None:
        settings["rate_hz"] = args.rate_hz
    order = Order(
        settings,
        read_calibration(args.calibration) if args.calibration is not None else None,
        args.calibration,
        KeyRing(args.key_file, create=True) if args.key_file is not None else None,
    )
    if args.roll_back and (order.changes or args.fleet is not None):
        raise InputError("--roll-back changes no settings; leave the others out")
    return order
