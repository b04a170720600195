"""Flash chip of a Pico as a file, and its file system as a folder of the host."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

from hubodo.emulator.interpreters.rp2040.image import FLASH_BYTES
from hubodo.errors import HubodoError

FLASH_BLOCK_BYTES = 4096
FILE_SYSTEM_OFFSET = 0xA0000
"""Offset of the file system: the last 1408 KiB of the flash (MicroPython, ports/rp2/boards/RPI_PICO)."""
_LITTLEFS_SETTINGS: dict[str, Any] = {
    "block_size": FLASH_BLOCK_BYTES,
    "block_count": (FLASH_BYTES - FILE_SYSTEM_OFFSET) // FLASH_BLOCK_BYTES,
    "prog_size": 256,
    "read_size": 256,
}
_LITTLEFS_VERSION = 0x0002_0000
"""On-disk version 2.0 of littlefs, that of MicroPython 1.28."""


class FlashUnreadable(HubodoError):
    """The flash chip holds no valid file system."""


def _little_fs(**settings: Any) -> Any:
    """Return a littlefs file system. Raise FlashUnreadable if the package is not installed."""
    try:
        from littlefs import LittleFS
    except ImportError:
        raise FlashUnreadable(
            "littlefs-python is not installed, the Pico's flash cannot be made: pip install 'hubodo[rp2040]'"
        ) from None
    return LittleFS(**_LITTLEFS_SETTINGS, **settings)


def make_flash(path: Path, firmware: bytes, folder: Path) -> None:
    """Write the image of a flash chip with MicroPython and the files of `folder`.

    Without files, as shipped.
    """
    chip = bytearray(b"\xff" * FLASH_BYTES)
    chip[: len(firmware)] = firmware
    files = [p for p in sorted(folder.rglob("*")) if p.is_file()]
    if files:
        fs = _little_fs(disk_version=_LITTLEFS_VERSION)
        for file in files:
            name = file.relative_to(folder).as_posix()
            fs.makedirs(str(PurePosixPath(name).parent), exist_ok=True)
            with fs.open(name, "wb") as out:
                out.write(file.read_bytes())
        chip[FILE_SYSTEM_OFFSET:] = fs.context.buffer
    path.write_bytes(chip)


def read_flash(path: Path) -> dict[str, bytes]:
    """Return the files in the image of a flash chip, by path on the board.

    Raise FlashUnreadable if there is no valid file system.
    """
    data = path.read_bytes()[FILE_SYSTEM_OFFSET:]
    if data.count(b"\xff") == len(data):
        return {}
    fs = _little_fs(mount=False)
    fs.context.buffer = bytearray(data)
    try:
        fs.mount()
        return {name: fs.open(name, "rb").read() for name in _file_paths(fs)}
    except Exception as error:  # noqa: BLE001  one exception type per kind of damage
        raise FlashUnreadable(f"{path}: no valid file system in this flash ({error})") from None


def _file_paths(fs: Any) -> Iterator[str]:
    """Yield the paths of all files."""
    for folder, _, names in fs.walk("/"):
        for name in names:
            yield str(PurePosixPath(folder) / name).lstrip("/")


def mirror_flash(path: Path, folder: Path) -> None:
    """Make `folder` hold exactly the files in the image. Raise FlashUnreadable."""
    files = read_flash(path)
    for path_in_folder in sorted(folder.rglob("*"), reverse=True):
        name = path_in_folder.relative_to(folder).as_posix()
        if path_in_folder.is_dir() and not any(file.startswith(name + "/") for file in files):
            shutil.rmtree(path_in_folder)
        elif path_in_folder.is_file() and name not in files:
            path_in_folder.unlink()
    for name, data in files.items():
        target = folder / name
        if not target.is_file() or target.read_bytes() != data:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
