"""Finds what an emulated Pico runs: MicroPython for it, the bootrom, and the symbols where there are any."""

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
_NOT_FLASH, _HAS_FAMILY, _RP2040 = 0x0001, 0x2000, 0xE48BFF56
_BOOTROM_BYTES = 16 * 1024
_ROOT = Path(__file__).resolve().parents[5]


class ImageMissing(HubodoError):
    """No image of MicroPython, or no bootrom, for the emulated Pico."""


@dataclass(frozen=True)
class PicoImage:
    """Files that the emulated Pico needs; without symbols nothing can be metered."""

    firmware: Path
    bootrom: Path
    symbols: Path | None

    def contents(self) -> bytes:
        """What stands in the flash chip from its first byte on.

        Raises:
            ImageMissing: the file is not for an RP2040, or too large for its flash.
        """
        data = self.firmware.read_bytes()
        contents = _from_uf2(self.firmware, data) if data[:4] == b"UF2\n" else data
        if not 0 < len(contents) <= FLASH_BYTES:
            raise ImageMissing(f"{self.firmware}: {len(contents)} bytes do not fit the Pico's flash")
        return contents


def usual_folder() -> Path:
    """Where images are looked for when nothing is named: beside the checkout."""
    return Path(os.environ.get("HUBODO_SHARED", _ROOT.parent / "shared")) / "rp2040"


def find_image(given: Path | None = None, bootrom: Path | None = None) -> PicoImage:
    """The image that is meant by a file or folder, or the usual one, with the bootrom and symbols beside it.

    Raises:
        ImageMissing: one of them is not there; the message says where to get it.
    """
    place = given if given is not None else usual_folder()
    firmware = _firmware_in(place) if place.is_dir() else place
    if firmware is None or not firmware.is_file():
        raise ImageMissing(
            f"{place}: no MicroPython for the Pico here; download RPI_PICO's .uf2 from "
            "micropython.org/download/RPI_PICO and name it with --image"
        )
    if bootrom is None:
        beside = [*sorted(firmware.parent.glob("bootrom*.bin")), *sorted(firmware.parent.glob("b[0-2].bin"))]
        bootrom = beside[0] if beside else None
    if bootrom is None or not bootrom.is_file() or bootrom.stat().st_size != _BOOTROM_BYTES:
        raise ImageMissing(
            f"{bootrom or firmware.parent}: no bootrom of the RP2040 here (16 KiB); download b1.bin from "
            "github.com/raspberrypi/pico-bootrom-rp2040/releases and put it beside the image or name it with "
            "--bootrom"
        )
    symbols = firmware.with_name(f"symbols{firmware.stem.partition('RPI_PICO')[2]}.txt")
    return PicoImage(firmware, bootrom, symbols if symbols.is_file() else None)


def _firmware_in(folder: Path) -> Path | None:
    """The plainest name of those that are images: a variant has something behind it."""
    found = [p for p in folder.iterdir() if "RPI_PICO" in p.name and p.suffix in (".bin", ".uf2")]
    return min(found, key=lambda p: (len(p.stem), p.name), default=None)


def _from_uf2(path: Path, data: bytes) -> bytes:
    out = bytearray()
    for at in range(0, len(data) - _UF2_BLOCK + 1, _UF2_BLOCK):
        one, two, flags, address, size, _, _, family = _UF2.unpack_from(data, at)
        start = address - FLASH_START
        foreign = flags & _HAS_FAMILY and family != _RP2040
        if (one, two) != _UF2_MAGIC or foreign or size > _UF2_DATA or not 0 <= start <= FLASH_BYTES - size:
            raise ImageMissing(f"{path}: block {at // _UF2_BLOCK} is not for the flash of an RP2040")
        if not flags & _NOT_FLASH:
            out.extend(b"\xff" * (start + size - len(out)))
            out[start : start + size] = data[at + _UF2.size : at + _UF2.size + size]
    return bytes(out)
