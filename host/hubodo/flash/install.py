"""A board brought to run the firmware, through a cable that may be pulled, or back to what ran before."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.errors import HubodoError
from hubodo.flash.board import FlashBoard
from hubodo.flash.image import build
from hubodo.flash.manifest import with_manifest
from hubodo.flash.node_settings import FROM_CALIBRATION
from hubodo.flash.order import CONFIG, Order
from hubodo.flash.prompt import BoardGone, FlashError
from hubodo.safe_text import json_text
from hubowire import FINGERPRINT
from hubowire.messages import Hello

_COMES_BACK_S = 60.0
"""So long the port of a board that went away is waited for."""
_MOST_TRIES = 20
_STARTS_S = 5.0
_LOOK_S = 0.2

Say = Callable[[str], None]


@dataclass(frozen=True)
class Flashed:
    """What a board holds and runs after flashing. again: how often it went away meanwhile."""

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
    again: int
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
            "keyed": self.keyed,
            "went_away": self.again,
            "seconds": round(self.seconds, 2),
        }


@dataclass(frozen=True)
class RolledBack:
    """A board that runs what it ran before. other_version: whether this host cannot read it."""

    port: str
    node: int
    fingerprint: int
    firmware: tuple[int, ...]

    @property
    def other_version(self) -> bool:
        return self.fingerprint != FINGERPRINT

    def as_json(self) -> dict[str, Any]:
        return {
            "port": self.port,
            "node": self.node,
            "firmware": ".".join(map(str, self.firmware)),
            "fingerprint": f"{self.fingerprint:08x}",
            "other_version": self.other_version,
        }


def install(port: str, order: Callable[[str], Order], folder: Path, say: Say) -> Flashed:
    """Flashes the firmware of `folder`; order: what the board with a serial is to become.

    A board that goes away is waited for, and what it has got by then is not sent again. Raises FlashError,
    ImageError, WireMismatch and what `order` raises.
    """
    started = time.monotonic()
    again = 0
    while True:
        try:
            return _install(port, order, folder, say, again, started)
        except BoardGone:
            again += 1
            if again > _MOST_TRIES:
                raise
            say(f"{port} went away: put the cable back, it goes on where it was")
            if not _comes_back(port):
                raise


def _install(
    port: str, order: Callable[[str], Order], folder: Path, say: Say, again: int, started: float
) -> Flashed:
    say(f"{port}: looking")
    with FlashBoard(port) as board:
        _reach(board, again)
        look = board.look()
        serial = board.unique_id()
        try:
            wanted = order(serial)
            config = wanted.config(board.config(), serial) if wanted.changes else {}
        except HubodoError:
            _run_again(board)
            raise
        say(f"{port}: compiling for {look.architecture or 'bytecode'}")
        image = with_manifest(build(folder, look.architecture))
        files = len(image) + wanted.changes
        if wanted.changes:
            image[CONFIG] = json_text(config).encode()
        copied = board.copy(image, lambda name: say(f"{port}: copying {name}"))
        say(f"{port}: starting")
        board.reset()
        node, hello = board.wait_hello()
    return Flashed(
        port,
        look.platform,
        look.text,
        look.architecture,
        files,
        tuple(copied),
        node,
        hello,
        {name: config[name] for name in FROM_CALIBRATION if name in config},
        bool(config.get("key")),
        again,
        time.monotonic() - started,
    )


def roll_back(port: str, say: Say) -> RolledBack:
    """Has a board run what it ran before it was flashed last; again: forth. Raises FlashError."""
    say(f"{port}: looking")
    with FlashBoard(port) as board:
        board.interrupt()
        try:
            board.roll_back()
        except FlashError:
            _run_again(board)
            raise
        say(f"{port}: starting")
        board.reset()
        node, fingerprint, version = board.wait_identity()
    return RolledBack(port, node, fingerprint, version)


def _run_again(board: FlashBoard) -> None:
    """What is not flashed after all goes on with what it has, if anything."""
    board.reset()
    with contextlib.suppress(FlashError):
        board.wait_identity(_STARTS_S)


def _reach(board: FlashBoard, again: int) -> None:
    """To its prompt; a port that has just come back may not be ready to be opened."""
    end = time.monotonic() + (_COMES_BACK_S if again else 0.0)
    while True:
        try:
            return board.interrupt()
        except FlashError:
            if time.monotonic() >= end:
                raise
            time.sleep(_LOOK_S)


def _comes_back(port: str) -> bool:
    end = time.monotonic() + _COMES_BACK_S
    while not Path(port).exists():
        if time.monotonic() >= end:
            return False
        time.sleep(_LOOK_S)
    return True
