"""Installation of the firmware on a board, robust against disconnection, and rollback."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.errors import HubodoError
from hubodo.flash.board import FlashBoard
from hubodo.flash.image import build_image
from hubodo.flash.manifest import add_manifest
from hubodo.flash.node_settings import FROM_CALIBRATION
from hubodo.flash.order import CONFIG, SettingsOrder
from hubodo.flash.prompt import BoardDisconnected, FlashError
from hubodo.safe_text import json_text
from hubowire import FINGERPRINT
from hubowire.messages import Hello

_PORT_RETURN_TIMEOUT_S = 60.0
"""Longest wait for the port of a disconnected board."""
_MAX_RECONNECTIONS = 20
_START_TIMEOUT_S = 5.0
_POLL_PERIOD_S = 0.2

ProgressReport = Callable[[str], None]


@dataclass(frozen=True)
class FlashedBoard:
    """The state of a board after flashing.

    Attributes
    ----------
    port
        Serial device.
    platform, micropython, architecture
        Identity of the board.
    files
        Number of files of the firmware.
    copied
        Names of the files that were copied.
    node, hello
        Id and identification of the running node.
    calibrated
        Settings that were derived from the calibration.
    keyed
        True if the node has a key for UDP.
    n_disconnections
        Number of disconnections during flashing.
    seconds
        Duration, s.
    """

    port: str
    platform: str
    micropython: str
    architecture: str | None
    files: int
    copied: tuple[str, ...]
    node: int
    hello: Hello
    calibrated: dict[str, object]
    keyed: bool
    n_disconnections: int
    seconds: float

    def as_json(self) -> dict[str, Any]:
        """Return the JSON form."""
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
            "keyed": self.keyed,
            "went_away": self.n_disconnections,
            "seconds": round(self.seconds, 2),
        }


@dataclass(frozen=True)
class RolledBackBoard:
    """A board after a rollback to its previous firmware."""

    port: str
    node: int
    fingerprint: int
    firmware: tuple[int, ...]

    @property
    def is_other_version(self) -> bool:
        """Return True if this host cannot decode the previous firmware."""
        return self.fingerprint != FINGERPRINT

    def as_json(self) -> dict[str, Any]:
        """Return the JSON form."""
        return {
            "port": self.port,
            "node": self.node,
            "firmware": ".".join(map(str, self.firmware)),
            "fingerprint": f"{self.fingerprint:08x}",
            "other_version": self.is_other_version,
        }


def install_firmware(
    port: str, order: Callable[[str], SettingsOrder], folder: Path, report_progress: ProgressReport
) -> FlashedBoard:
    """Install the firmware of `folder`; `order` gives the settings of a board by its serial number.

    A disconnected board is waited for, and files already copied are not sent again. Raises FlashError,
    ImageError, WireMismatch and the errors of `order`.
    """
    started = time.monotonic()
    n_reconnections = 0
    while True:
        try:
            return _install(port, order, folder, report_progress, n_reconnections, started)
        except BoardDisconnected:
            n_reconnections += 1
            if n_reconnections > _MAX_RECONNECTIONS:
                raise
            report_progress(f"{port} disconnected: reconnect the cable to continue")
            if not _wait_for_port(port):
                raise


def _install(
    port: str,
    order: Callable[[str], SettingsOrder],
    folder: Path,
    report_progress: ProgressReport,
    n_reconnections: int,
    started: float,
) -> FlashedBoard:
    report_progress(f"{port}: identifying")
    with FlashBoard(port) as board:
        _reach_prompt(board, n_reconnections)
        identity = board.identify()
        serial = board.unique_id()
        try:
            board_order = order(serial)
            config = board_order.config(board.config(), serial) if board_order.has_changes else {}
        except HubodoError:
            _restart(board)
            raise
        report_progress(f"{port}: compiling for {identity.architecture or 'bytecode'}")
        image = add_manifest(build_image(folder, identity.architecture))
        files = len(image) + board_order.has_changes
        if board_order.has_changes:
            image[CONFIG] = json_text(config).encode()
        copied = board.copy(image, lambda name: report_progress(f"{port}: copying {name}"))
        report_progress(f"{port}: starting")
        board.reset()
        node, hello = board.wait_hello()
    return FlashedBoard(
        port,
        identity.platform,
        identity.text,
        identity.architecture,
        files,
        tuple(copied),
        node,
        hello,
        {name: config[name] for name in FROM_CALIBRATION if name in config},
        bool(config.get("key")),
        n_reconnections,
        time.monotonic() - started,
    )


def roll_back(port: str, report_progress: ProgressReport) -> RolledBackBoard:
    """Restart the previous firmware of a board; a second rollback reverts it. Raises FlashError."""
    report_progress(f"{port}: identifying")
    with FlashBoard(port) as board:
        board.interrupt()
        try:
            board.roll_back()
        except FlashError:
            _restart(board)
            raise
        report_progress(f"{port}: starting")
        board.reset()
        node, fingerprint, version = board.wait_identity()
    return RolledBackBoard(port, node, fingerprint, version)


def _restart(board: FlashBoard) -> None:
    """Restart a board that is not flashed after all."""
    board.reset()
    with contextlib.suppress(FlashError):
        board.wait_identity(_START_TIMEOUT_S)


def _reach_prompt(board: FlashBoard, n_reconnections: int) -> None:
    """Enter the prompt; a port that has just returned may not be ready yet."""
    end = time.monotonic() + (_PORT_RETURN_TIMEOUT_S if n_reconnections else 0.0)
    while True:
        try:
            return board.interrupt()
        except FlashError:
            if time.monotonic() >= end:
                raise
            time.sleep(_POLL_PERIOD_S)


def _wait_for_port(port: str) -> bool:
    end = time.monotonic() + _PORT_RETURN_TIMEOUT_S
    while not Path(port).exists():
        if time.monotonic() >= end:
            return False
        time.sleep(_POLL_PERIOD_S)
    return True
