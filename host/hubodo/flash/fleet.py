"""Many boards: which ports have one, who is who by a table of serials; one that fails stops no other."""

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
"""USB vendors of boards and of the converters on them; other ports are left alone."""


class _UsbPort(Protocol):
    device: str
    vid: int | None


class NotInTable(HubodoError):
    """A board that the table does not name; it is left as it is."""


@dataclass(frozen=True)
class BoardFailed:
    """A board that was not done. left: it is in no table, and was left alone on purpose."""

    port: str
    error: str
    left: bool = False

    def as_json(self) -> dict[str, Any]:
        return {"port": self.port, "error": self.error, "left_alone": self.left}


@dataclass(frozen=True)
class Fleet:
    """What became of each board."""

    boards: tuple[Flashed | RolledBack | BoardFailed, ...]

    @property
    def failed(self) -> bool:
        return any(isinstance(board, BoardFailed) and not board.left for board in self.boards)

    def as_json(self) -> dict[str, Any]:
        return {
            "boards": [board.as_json() for board in self.boards],
            "done": sum(not isinstance(board, BoardFailed) for board in self.boards),
            "failed": sum(isinstance(board, BoardFailed) and not board.left for board in self.boards),
        }


def found_ports(lister: Callable[[], Iterable[Any]] = list_devices) -> list[str]:
    """The ports that may be boards, by their USB vendor. Raises InputError when there is none."""
    seen: list[_UsbPort] = list(lister())
    ports = sorted(info.device for info in seen if info.vid in BOARD_VENDORS)
    if not ports:
        others = ", ".join(info.device for info in seen) or "no port at all"
        raise InputError(f"--all: no board is plugged in; there is: {others}; name ports that are boards")
    return ports


def read_fleet(path: Path) -> dict[str, int]:
    """Node ids by serial of the board: ``[nodes]`` serial = "left". Raises InputError and ConfigError."""
    if not path.exists():
        raise InputError(f'{path}: no such file; write [nodes] with lines such as e6614103e7452d2f = "left"')
    table = load_toml(path)
    rows = table.get("nodes")
    if set(table) != {"nodes"} or not isinstance(rows, dict):
        raise ConfigError(f'{path}: wants one table [nodes] with SERIAL = "NAME" and nothing else')
    fleet = {
        str(serial).lower(): node_id(str(name), f"{path}: {quote_value(serial)} =")
        for serial, name in rows.items()
    }
    twice = {number for number in fleet.values() if list(fleet.values()).count(number) > 1}
    if twice:
        raise ConfigError(f"{path}: node {min(twice)} is there twice; each board has a name of its own")
    return fleet


def orders(order: Order, fleet: dict[str, int] | None) -> Callable[[str], Order]:
    """The order for the board with a serial; it raises NotInTable for one that the table does not name."""

    def of(serial: str) -> Order:
        if fleet is None:
            return order
        if serial not in fleet:
            raise NotInTable(f"serial {serial} is not in the table; left as it is")
        return replace(order, settings={**order.settings, "node_id": fleet[serial]})

    return of


def each(ports: Iterable[str], do: Callable[[str], Flashed | RolledBack]) -> Fleet:
    """Every board in turn; one that fails does not stop the others."""
    boards: list[Flashed | RolledBack | BoardFailed] = []
    for port in ports:
        try:
            boards.append(do(port))
        except HubodoError as error:
            boards.append(BoardFailed(port, str(error), isinstance(error, NotInTable)))
    return Fleet(tuple(boards))
