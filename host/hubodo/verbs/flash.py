"""`hubodo flash`: compile the firmware, install it by cable or by the node's link, and verify what runs."""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.calibration.file import read_calibration
from hubodo.errors import InputError
from hubodo.flash.fleet import (
    FailedBoard,
    FleetOutcome,
    flash_each,
    list_board_ports,
    orders_by_serial,
    read_fleet,
)
from hubodo.flash.image import firmware_folder
from hubodo.flash.install import FlashedBoard, RolledBackBoard, install_firmware, roll_back
from hubodo.flash.order import SettingsOrder, parse_node_id, parse_settings
from hubodo.flash.over_air import UpdatedNode, roll_back_over_air, update_over_air
from hubodo.ingest.link.keys import KeyRing
from hubodo.ingest.link.ports import BLE_KIND, attach_keys, parse_port
from hubodo.terminal import SafeConsole
from hubowire import node_name

EXAMPLE = (
    "hubodo flash /dev/ttyACM0 --node left\n  hubodo flash --all --fleet fleet.toml\n"
    "  hubodo flash /dev/ttyACM0 --set link=udp --set ssid=net --set password=... --set host=laptop.local "
    "--key-file keys.toml\n  hubodo flash /dev/ttyACM0 --roll-back\n"
    "  hubodo flash udp://0.0.0.0:47110 --node left --key-file keys.toml"
)
_OVER_AIR = ("udp", BLE_KIND)


@dataclass(frozen=True)
class BoardResult:
    """The result of flashing one board."""

    board: FlashedBoard | RolledBackBoard | UpdatedNode

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return self.board.as_json()

    def render(self, console: Console) -> None:
        """Print the result as a table."""
        table = Table(title=f"running on {self.board.port}", show_header=False)
        for key, value in self.as_json().items():
            if key == "copied":
                value = ", ".join(value) or "nothing: all files were up to date"
            elif key == "calibrated":
                value = ", ".join(f"{name} {setting}" for name, setting in value.items()) or "-"
            table.add_row(key, str(value))
        console.print(table)
        if isinstance(self.board, RolledBackBoard) and self.board.is_other_version:
            console.print(
                "this host runs another version: install the hubodo that flashed the board, or flash it again"
            )


@dataclass(frozen=True)
class FleetResult:
    """The results of flashing several boards."""

    fleet: FleetOutcome

    @property
    def failed(self) -> bool:
        """Return True if flashing a board failed."""
        return self.fleet.failed

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return self.fleet.as_json()

    def render(self, console: Console) -> None:
        """Print one row for each board."""
        table = Table("port", "node", "serial", "firmware", "action", title="boards")
        for board in self.fleet.boards:
            if isinstance(board, FailedBoard):
                table.add_row(board.port, "", "", "", ("" if board.is_skipped else "FAILED: ") + board.error)
                continue
            summary = board.as_json()
            action = (
                "rolled back" if isinstance(board, RolledBackBoard) else f"{len(board.copied)} files copied"
            )
            table.add_row(
                board.port, node_name(board.node), summary.get("serial", ""), summary["firmware"], action
            )
        console.print(table)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo flash`."""
    parser.add_argument(
        "ports",
        nargs="*",
        metavar="PORT",
        help="serial devices of boards; udp://HOST:PORT (listen) or ble://NAME: a running node with a key",
    )
    parser.add_argument("--all", action="store_true", help="all USB ports that may belong to a board")
    parser.add_argument(
        "--fleet",
        type=Path,
        metavar="TOML",
        help='names of the boards: [nodes] with lines serial = "left"; others are skipped',
    )
    parser.add_argument(
        "--node",
        help="left, right, frame or a number from 1 to 254 (default: unchanged); over Wi-Fi or "
        "Bluetooth: which node",
    )
    parser.add_argument("--rate-hz", type=int, help="sample rate (default: unchanged)")
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
        help="bias, warm-up and filter gain for the node, from `hubodo calibrate` (default: unchanged)",
    )
    parser.add_argument(
        "--key-file",
        type=Path,
        metavar="TOML",
        help="keys for UDP by serial number, as used by `hubodo record`; a new board gets a new key",
    )
    parser.add_argument(
        "--roll-back",
        action="store_true",
        help="return to the previously installed firmware; settings are kept",
    )


def run(args: argparse.Namespace) -> BoardResult | FleetResult:
    """Install the firmware on the given boards, or roll back to the previous one.

    Returns
    -------
    BoardResult or FleetResult
        Port, node, firmware and copied files of each board.

    Raises
    ------
    InputError
        If ports or options contradict each other.
    LinkError
        If the only board does not answer.
    """
    if bool(args.ports) == args.all:
        raise InputError("name ports such as /dev/ttyACM0, or --all for every board that is plugged in")
    if any(text.startswith(tuple(f"{kind}://" for kind in _OVER_AIR)) for text in args.ports):
        return _update_node(args)
    fleet = read_fleet(args.fleet) if args.fleet is not None else None
    is_fleet = args.all or len(args.ports) > 1 or fleet is not None
    order = _order(args, is_fleet)
    ports = list_board_ports() if args.all else args.ports
    note = SafeConsole(stderr=True)
    with note.status("searching for boards") as status:

        def flash(port: str) -> FlashedBoard | RolledBackBoard:
            if args.roll_back:
                return roll_back(port, status.update)
            return install_firmware(port, orders_by_serial(order, fleet), firmware_folder(), status.update)

        if not is_fleet:
            return BoardResult(flash(args.ports[0]))
        return FleetResult(flash_each(ports, flash))


def _update_node(args: argparse.Namespace) -> BoardResult:
    """Update one node by its link, which the port names."""
    if len(args.ports) > 1 or args.fleet is not None:
        raise InputError("over Wi-Fi or Bluetooth nodes are flashed one by one: give one port, and --node")
    if args.calibration is not None:
        raise InputError(f"{args.ports[0]}: a calibration is written by USB; the host applies it as well")
    settings = parse_settings(args.set)
    if args.rate_hz is not None:
        settings["rate_hz"] = args.rate_hz
    if args.roll_back and settings:
        raise InputError("--roll-back changes no settings; remove the other options")
    if args.key_file is None:
        raise InputError(
            f"{args.ports[0]}: give the --key-file of `hubodo flash` by USB; without a key a node refuses"
        )
    port = attach_keys(parse_port(args.ports[0]), args.key_file, insecure=())
    node_id = None if args.node is None else parse_node_id(args.node)
    with SafeConsole(stderr=True).status("searching for the node") as status:
        if args.roll_back:
            return BoardResult(roll_back_over_air(port, node_id, status.update))
        return BoardResult(update_over_air(port, node_id, firmware_folder(), settings, status.update))


def _order(args: argparse.Namespace, is_fleet: bool) -> SettingsOrder:
    settings = parse_settings(args.set)
    if args.node is not None:
        if is_fleet:
            raise InputError("--node is for one board; name several with --fleet TOML")
        settings["node_id"] = parse_node_id(args.node)
    if args.rate_hz is not None:
        settings["rate_hz"] = args.rate_hz
    order = SettingsOrder(
        settings,
        read_calibration(args.calibration) if args.calibration is not None else None,
        args.calibration,
        KeyRing(args.key_file, create=True) if args.key_file is not None else None,
    )
    if args.roll_back and (order.has_changes or args.fleet is not None):
        raise InputError("--roll-back changes no settings; remove the other options")
    return order
