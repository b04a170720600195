"""Flashing of many boards: their ports, their names by serial number, and errors of each board."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from hubodo.errors import ConfigError, HubodoError, InputError
from hubodo.flash.install import FlashedBoard, RolledBackBoard
from hubodo.flash.order import SettingsOrder, parse_node_id
from hubodo.ingest.link.ports import list_devices
from hubodo.toml_file import load_toml, quote_value

BOARD_VENDORS = {
    0x2E8A: "Raspberry Pi",
    0x303A: "Espressif",
    0x10C4: "CP210x of an ESP32",
    0x1A86: "CH34x of an ESP32",
    0x0403: "FTDI",
}
"""USB vendors of boards and of their converters; other ports are ignored."""


class _UsbPort(Protocol):
    device: str
    vid: int | None


class BoardNotListed(HubodoError):
    """The error for a board that the fleet table does not name; it is left unchanged."""


@dataclass(frozen=True)
class FailedBoard:
    """A board that was not flashed; is_skipped: True because the fleet table does not name it."""

    port: str
    error: str
    is_skipped: bool = False

    def as_json(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {"port": self.port, "error": self.error, "left_alone": self.is_skipped}


@dataclass(frozen=True)
class FleetOutcome:
    """The outcome for each board."""

    boards: tuple[FlashedBoard | RolledBackBoard | FailedBoard, ...]

    @property
    def failed(self) -> bool:
        """Return True if flashing a board failed."""
        return any(isinstance(board, FailedBoard) and not board.is_skipped for board in self.boards)

    def as_json(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "boards": [board.as_json() for board in self.boards],
            "done": sum(not isinstance(board, FailedBoard) for board in self.boards),
            "failed": sum(isinstance(board, FailedBoard) and not board.is_skipped for board in self.boards),
        }


def list_board_ports(lister: Callable[[], Iterable[Any]] = list_devices) -> list[str]:
    """Return the ports that may belong to boards, by USB vendor; raise InputError if there are none."""
    devices: list[_UsbPort] = list(lister())
    ports = sorted(info.device for info in devices if info.vid in BOARD_VENDORS)
    if not ports:
        others = ", ".join(info.device for info in devices) or "no port"
        raise InputError(f"--all: no board is connected, only: {others}; name the ports of the boards")
    return ports


def read_fleet(path: Path) -> dict[str, int]:
    """Return node ids by serial number from a fleet file; raise InputError or ConfigError."""
    if not path.exists():
        raise InputError(f'{path}: no such file; write [nodes] with lines such as e6614103e7452d2f = "left"')
    table = load_toml(path)
    rows = table.get("nodes")
    if set(table) != {"nodes"} or not isinstance(rows, dict):
        raise ConfigError(f'{path}: must hold one table [nodes] with SERIAL = "NAME" and nothing else')
    fleet = {
        str(serial).lower(): parse_node_id(str(name), f"{path}: {quote_value(serial)} =")
        for serial, name in rows.items()
    }
    duplicates = {number for number in fleet.values() if list(fleet.values()).count(number) > 1}
    if duplicates:
        raise ConfigError(
            f"{path}: node {min(duplicates)} is used more than once; give each board its own name"
        )
    return fleet


def orders_by_serial(order: SettingsOrder, fleet: dict[str, int] | None) -> Callable[[str], SettingsOrder]:
    """Return a function that gives a board's order by its serial number, or raises BoardNotListed."""

    def order_for(serial: str) -> SettingsOrder:
        if fleet is None:
            return order
        if serial not in fleet:
            raise BoardNotListed(f"serial {serial} is not in the table; skipped")
        return replace(order, settings={**order.settings, "node_id": fleet[serial]})

    return order_for


def flash_each(ports: Iterable[str], flash: Callable[[str], FlashedBoard | RolledBackBoard]) -> FleetOutcome:
    """Process the boards one by one; a failure does not stop the others."""
    boards: list[FlashedBoard | RolledBackBoard | FailedBoard] = []
    for port in ports:
        try:
            boards.append(flash(port))
        except HubodoError as error:
            boards.append(FailedBoard(port, str(error), isinstance(error, BoardNotListed)))
    return FleetOutcome(tuple(boards))
