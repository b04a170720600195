"""Flashing of many boards: their ports, their names by serial number, and errors of each board."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from hubodo.errors import ConfigError, HubodoError, InputError
from hubodo.flash.install import Flashed, RolledBack
from hubodo.flash.order import Order, node_id
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


class NotInTable(HubodoError):
    """The error for a board that the fleet table does not name; it is left unchanged."""


@dataclass(frozen=True)
class BoardFailed:
    """A board that was not flashed; `left` is True if it was skipped because no table names it."""

    port: str
    error: str
    left: bool = False

    def as_json(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {"port": self.port, "error": self.error, "left_alone": self.left}


@dataclass(frozen=True)
class Fleet:
    """The outcome for each board."""

    boards: tuple[Flashed | RolledBack | BoardFailed, ...]

    @property
    def failed(self) -> bool:
        """Return True if flashing a board failed."""
        return any(isinstance(board, BoardFailed) and not board.left for board in self.boards)

    def as_json(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "boards": [board.as_json() for board in self.boards],
            "done": sum(not isinstance(board, BoardFailed) for board in self.boards),
            "failed": sum(isinstance(board, BoardFailed) and not board.left for board in self.boards),
        }


def found_ports(lister: Callable[[], Iterable[Any]] = list_devices) -> list[str]:
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
        str(serial).lower(): node_id(str(name), f"{path}: {quote_value(serial)} =")
        for serial, name in rows.items()
    }
    duplicates = {number for number in fleet.values() if list(fleet.values()).count(number) > 1}
    if duplicates:
        raise ConfigError(
            f"{path}: node {min(duplicates)} is used more than once; give each board its own name"
        )
    return fleet


def orders(order: Order, fleet: dict[str, int] | None) -> Callable[[str], Order]:
    """Return a function from serial number to the order of that board; it raises NotInTable."""

    def order_for(serial: str) -> Order:
        if fleet is None:
            return order
        if serial not in fleet:
            raise NotInTable(f"serial {serial} is not in the table; skipped")
        return replace(order, settings={**order.settings, "node_id": fleet[serial]})

    return order_for


def each(ports: Iterable[str], flash: Callable[[str], Flashed | RolledBack]) -> Fleet:
    """Process the boards one by one; a failure does not stop the others."""
    boards: list[Flashed | RolledBack | BoardFailed] = []
    for port in ports:
        try:
            boards.append(flash(port))
        except HubodoError as error:
            boards.append(BoardFailed(port, str(error), isinstance(error, NotInTable)))
    return Fleet(tuple(boards))
