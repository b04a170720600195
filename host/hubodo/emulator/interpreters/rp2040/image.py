"""Find the files of an emulated Pico: MicroPython image, bootrom and optional symbols."""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path

from hubodo.errors import HubodoError

FLASH_START = 0x1000_0000
FLASH_BYTES = 2 * 1024 * 1024
_UF2 = struct.Struct("<8I")
_UF2_BLOCK, _UF2_DATA = 512, 476
_UF2_MAGIC = (0x0A324655, 0x9E5D5157)
_UF2_NOT_FLASH, _UF2_HAS_FAMILY, _UF2_FAMILY_RP2040 = 0x0001, 0x2000, 0xE48BFF56
_BOOTROM_BYTES = 16 * 1024
_ROOT = Path(__file__).resolve().parents[5]


class ImageMissing(HubodoError):
    """The MicroPython image or the bootrom of the emulated Pico is missing."""


@dataclass(frozen=True)
class PicoImage:
    """Files of an emulated Pico; profiling needs the symbols."""

    firmware: Path
    bootrom: Path
    symbols: Path | None

    def contents(self) -> bytes:
        """Return the contents of the flash chip from its first byte on.

        Raise ImageMissing if the file is not for an RP2040, or too large for its flash.
        """
        data = self.firmware.read_bytes()
        contents = _from_uf2(self.firmware, data) if data[:4] == b"UF2\n" else data
        if not 0 < len(contents) <= FLASH_BYTES:
            raise ImageMissing(f"{self.firmware}: {len(contents)} bytes do not fit the Pico's flash")
        return contents


def default_image_folder() -> Path:
    """Return the default folder of images, beside the checkout."""
    return Path(os.environ.get("HUBODO_SHARED", _ROOT.parent / "shared")) / "rp2040"


def find_image(path: Path | None = None, bootrom: Path | None = None) -> PicoImage:
    """Return the image in a file or folder, or in the default folder, with bootrom and symbols beside it.

    Raise ImageMissing if one of them is missing; the message says where to get it.
    """
    location = path if path is not None else default_image_folder()
    firmware = _find_firmware(location) if location.is_dir() else location
    if firmware is None or not firmware.is_file():
        raise ImageMissing(
            f"{location}: no MicroPython for the Pico here; download RPI_PICO's .uf2 from "
            "micropython.org/download/RPI_PICO and name it with --image"
        )
    if bootrom is None:
        bootroms = [
            *sorted(firmware.parent.glob("bootrom*.bin")),
            *sorted(firmware.parent.glob("b[0-2].bin")),
        ]
        bootrom = bootroms[0] if bootroms else None
    if bootrom is None or not bootrom.is_file() or bootrom.stat().st_size != _BOOTROM_BYTES:
        raise ImageMissing(
            f"{bootrom or firmware.parent}: no bootrom of the RP2040 here (16 KiB); download b1.bin from "
            "github.com/raspberrypi/pico-bootrom-rp2040/releases and put it beside the image or name it with "
            "--bootrom"
        )
    symbols = firmware.with_name(f"symbols{firmware.stem.partition('RPI_PICO')[2]}.txt")
    return PicoImage(firmware, bootrom, symbols if symbols.is_file() else None)


def _find_firmware(folder: Path) -> Path | None:
    """Return the image with the shortest name in a folder: variants have a suffix."""
    images = [p for p in folder.iterdir() if "RPI_PICO" in p.name and p.suffix in (".bin", ".uf2")]
    return min(images, key=lambda p: (len(p.stem), p.name), default=None)


def _from_uf2(path: Path, data: bytes) -> bytes:
    """Return the flash contents of a UF2 file. Raise ImageMissing if it is not for an RP2040."""
    out = bytearray()
    for offset in range(0, len(data) - _UF2_BLOCK + 1, _UF2_BLOCK):
        first_magic, second_magic, flags, address, size, _, _, family = _UF2.unpack_from(data, offset)
        start = address - FLASH_START
        is_foreign = flags & _UF2_HAS_FAMILY and family != _UF2_FAMILY_RP2040
        if (
            (first_magic, second_magic) != _UF2_MAGIC
            or is_foreign
            or size > _UF2_DATA
            or not 0 <= start <= FLASH_BYTES - size
        ):
            raise ImageMissing(f"{path}: block {offset // _UF2_BLOCK} is not for the flash of an RP2040")
        if not flags & _UF2_NOT_FLASH:
            out.extend(b"\xff" * (start + size - len(out)))
            out[start : start + size] = data[offset + _UF2.size : offset + _UF2.size + size]
    return bytes(out)
