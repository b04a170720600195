"""The Pico's flash chip as a file, and the file system in it as a folder of the host."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from hubodo.emulator.interpreters.rp2040.image import FLASH_BYTES
from hubodo.errors import HubodoError

BLOCK = 4096
AT = 0xA0000
"""MicroPython's ports/rp2/boards/RPI_PICO: the last 1408 KiB of the flash are the file system."""
_SETTINGS: dict[str, Any] = {
    "block_size": BLOCK,
    "block_count": (FLASH_BYTES - AT) // BLOCK,
    "prog_size": 256,
    "read_size": 256,
}
_VERSION = 0x0002_0000
"""On disk: MicroPython 1.28 makes and wants littlefs 2.0."""


class FlashUnreadable(HubodoError):
    """What stands in the flash chip is no file system."""


def _little_fs(**settings: Any) -> Any:
    try:
        from littlefs import LittleFS
    except ImportError:
        raise FlashUnreadable(
            "littlefs-python is not installed, the Pico's flash cannot be made: pip install 'hubodo[rp2040]'"
        ) from None
    return LittleFS(**_SETTINGS, **settings)


def make_flash(path: Path, firmware: bytes, folder: Path) -> None:
    """Writes the image of a flash chip: MicroPython and the files of `folder`; without files, as bought."""
    chip = bytearray(b"\xff" * FLASH_BYTES)
    chip[: len(firmware)] = firmware
    files = [p for p in sorted(folder.rglob("*")) if p.is_file()]
    if files:
        fs = _little_fs(disk_version=_VERSION)
        for file in files:
            name = file.relative_to(folder).as_posix()
            fs.makedirs(str(PurePosixPath(name).parent), exist_ok=True)
            with fs.open(name, "wb") as out:
                out.write(file.read_bytes())
        chip[AT:] = fs.context.buffer
    path.write_bytes(chip)


def read_flash(path: Path) -> dict[str, bytes]:
    """The files in the image of a flash chip, by their path on the board.

    Raises:
        FlashUnreadable: there is no whole file system in it.
    """
    data = path.read_bytes()[AT:]
    if data.count(b"\xff") == len(data):
        return {}
    fs = _little_fs(mount=False)
    fs.context.buffer = bytearray(data)
    try:
        fs.mount()
        return {name: fs.open(name, "rb").read() for name in _names(fs)}
    except Exception as broken:  # noqa: BLE001  littlefs-python has an exception of its own for each kind of damage
        raise FlashUnreadable(f"{path}: no file system in this flash ({broken})") from None


def _names(fs: Any) -> Iterator[str]:
    for folder, _, names in fs.walk("/"):
        for name in names:
            yield str(PurePosixPath(folder) / name).lstrip("/")


def mirror_flash(path: Path, folder: Path) -> None:
    """Makes `folder` hold what the file system in the image holds, nothing else. Raises FlashUnreadable."""
    files = read_flash(path)
    for old in sorted(folder.rglob("*"), reverse=True):
        name = old.relative_to(folder).as_posix()
        if old.is_dir() and not any(kept.startswith(name + "/") for kept in files):
            shutil.rmtree(old)
        elif old.is_file() and name not in files:
            old.unlink()
    for name, data in files.items():
        target = folder / name
        if not target.is_file() or target.read_bytes() != data:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
