"""One emulated Pico of a virtual board: its files, and its flash chip as a file while it is switched on."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from hubodo.emulator.interpreters.rp2040.filesystem import make_flash, mirror_flash
from hubodo.emulator.interpreters.rp2040.image import find_image


@dataclass(frozen=True)
class PicoSettings:
    """What can be chosen about an emulated Pico.

    Attributes:
        image, bootrom: see `image.find_image`; None: the usual ones.
        miss_cycles: cycles of the processor per miss of the cache before its flash; an estimate.
        flash_image: file that is the flash chip; used as it is where it exists, else made from the board's
            files. None: a temporary one, made anew at each power-on.
        meter_from: s of true time from which it is counted what the processor does; None: never.
        profile: whether that is told for each function of the firmware too.
    """

    image: Path | None = None
    bootrom: Path | None = None
    miss_cycles: int = 50
    flash_image: Path | None = None
    meter_from: float | None = None
    profile: bool = False


class Pico:
    """The flash chip is made at power-on from the files in `folder`; processors come and go, it stays.

    Raises:
        ImageMissing, FlashUnreadable: see there.
    """

    def __init__(self, settings: PicoSettings, folder: Path) -> None:
        self._settings, self._files = settings, folder
        self._image = find_image(settings.image, settings.bootrom)
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        if settings.flash_image is None:
            self._folder = tempfile.TemporaryDirectory(prefix="hubodo-pico-")
            self._flash = Path(self._folder.name) / "flash.bin"
        else:
            self._flash = settings.flash_image
        if not self._flash.exists():
            make_flash(self._flash, self._image.contents(), folder)

    def for_runner(self) -> dict[str, object]:
        """What rp2040/runner.mjs has to know of it."""
        symbols = self._image.symbols
        return {
            "bootrom": str(self._image.bootrom),
            "symbols": None if symbols is None else str(symbols),
            "flash_image": str(self._flash),
            "miss_cycles": self._settings.miss_cycles,
            "meter_from": self._settings.meter_from,
            "profile": self._settings.profile,
        }

    def mirror(self) -> None:
        """The chip's files to the board's folder. Raises FlashUnreadable."""
        mirror_flash(self._flash, self._files)
