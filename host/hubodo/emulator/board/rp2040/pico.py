"""One emulated Pico of a virtual board: its files, and its flash chip as a file while it is switched on."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from hubodo.emulator.board.rp2040.filesystem import make_flash, mirror_flash
from hubodo.emulator.board.rp2040.image import find_image

if TYPE_CHECKING:
    from hubodo.emulator.board.settings import BoardSettings


class Pico:
    """The flash chip is made at power-on; processors come and go, it stays.

    Raises:
        ImageMissing, FlashUnreadable: see there.
    """

    def __init__(self, settings: BoardSettings) -> None:
        self._settings = settings
        self._image = find_image(settings.image, settings.bootrom)
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        if settings.flash_image is None:
            self._folder = tempfile.TemporaryDirectory(prefix="hubodo-pico-")
            self._flash = Path(self._folder.name) / "flash.bin"
        else:
            self._flash = settings.flash_image
        if not self._flash.exists():
            make_flash(self._flash, self._image.contents(), settings.flash)

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
        """The chip's files to the folder `flash` of the settings. Raises FlashUnreadable."""
        mirror_flash(self._flash, self._settings.flash)
