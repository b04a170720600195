"""`hubodo flash`: compile the firmware, copy it to a board, prove what it holds, and say what runs."""

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from hubodo.calibration.file import Calibration, read_calibration
from hubodo.errors import CalibrationError, InputError, WireMismatch
from hubodo.flash.board import FlashBoard
from hubodo.flash.image import build, firmware_folder
from hubodo.flash.node_settings import FROM_CALIBRATION, merged
from hubowire import FINGERPRINT
from hubowire.messages import NODE_IDS, Hello, node_name

EXAMPLE = "hubodo flash /dev/ttyACM0 --node left"

_CONFIG = "config.json"


@dataclass(frozen=True)
class Flashed:
    """What a board holds and runs after flashing."""

    port: str
    platform: str
    micropython: str
    architecture: str | None
    files: int
    copied: tuple[str, ...]
    node: int
    hello: Hello
    calibrated: dict[str, object]
    seconds: float

    def as_json(self) -> dict[str, Any]:
        return {
            "port": self.port,
            "platform": self.platform,
            "micropython": self.micropython,
            "architecture": self.architecture,
            "files": self.files,
            "copied": list(self.copied),
            "node": self.node,
            "firmware": ".".join(map(str, self.hello.firmware)),
            "fingerprint": f"{self.hello.fingerprint:08x}",
            "serial": self.hello.serial.hex(),
            "calibrated": self.calibrated,
            "seconds": round(self.seconds, 2),
        }

    def render(self, console: Console) -> None:
        table = Table(title=f"running on {self.port}", show_header=False)
        for key, value in self.as_json().items():
            if key == "copied":
                value = ", ".join(value) or "nothing: all files were there"
            elif key == "calibrated":
                value = ", ".join(f"{name} {setting}" for name, setting in value.items()) or "-"
            table.add_row(key, str(value))
        console.print(table)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("port", metavar="PORT", help="serial device of the board")
    parser.add_argument("--node", help="left, right, frame or a number from 1 to 255 (default: as it is)")
    parser.add_argument("--rate-hz", type=int, help="sample rate (default: as it is)")
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="TOML",
        help="from `hubodo calibrate`: bias, warm-up and filter gain for the node (default: as they are)",
    )


def node_id(text: str) -> int:
    """The number behind a node's name. Raises InputError for a name that is none."""
    if text in NODE_IDS:
        return NODE_IDS[text]
    if text.isdigit() and 1 <= int(text) <= 255:
        return int(text)
    raise InputError(f"--node {text}: use {', '.join(NODE_IDS)} or a number from 1 to 255")


def run(args: argparse.Namespace) -> Flashed:
    settings: dict[str, object] = {}
    if args.node is not None:
        settings["node_id"] = node_id(args.node)
    if args.rate_hz is not None:
        settings["rate_hz"] = args.rate_hz
    calibration = read_calibration(args.calibration) if args.calibration is not None else None
    started = time.monotonic()
    note = Console(stderr=True)
    with note.status(f"{args.port}: looking") as status, FlashBoard(args.port) as board:
        board.interrupt()
        look = board.look()
        config = board.config() | settings if settings or calibration else {}
        if calibration is not None:
            config = _calibrated(config, calibration, args.calibration, board.unique_id())
        status.update(f"compiling for {look.architecture or 'bytecode'}")
        image = build(firmware_folder(), look.architecture)
        if settings or calibration is not None:
            image[_CONFIG] = json.dumps(config).encode()
        copied = board.copy(image, lambda name: status.update(f"copying {name}"))
        status.update("starting")
        board.reset()
        node, hello = board.wait_hello()
    if hello.fingerprint != FINGERPRINT:
        raise WireMismatch(
            f"{args.port}: node speaks {hello.fingerprint:08x}, host speaks {FINGERPRINT:08x}: "
            "the firmware that runs is not the one that was copied; remove other files from the board"
        )
    calibrated = {name: config[name] for name in FROM_CALIBRATION if name in config}
    seconds = time.monotonic() - started
    return Flashed(
        args.port,
        look.platform,
        look.text,
        look.architecture,
        len(image),
        tuple(copied),
        node,
        hello,
        calibrated,
        seconds,
    )


def _calibrated(
    config: dict[str, object], calibration: Calibration, path: Path, serial: str
) -> dict[str, object]:
    """The node's settings with its part of the file.

    Raises InputError when the file has none for it, CalibrationError when it is of another board.
    """
    number = config.get("node_id", 1)
    name = node_name(number if isinstance(number, int) else 1)
    if name not in calibration.nodes:
        known = ", ".join(calibration.nodes) or "none"
        raise InputError(f"{path}: no node {name!r}, only {known}; give --node, or calibrate this one")
    node = calibration.nodes[name]
    if node.serial and node.serial.lower() != serial.lower():
        raise CalibrationError(
            f"{path}: nodes.{name} is of the board with serial {node.serial}, this one has {serial}; "
            "give its own calibration, or another --node"
        )
    return merged(config, node)
