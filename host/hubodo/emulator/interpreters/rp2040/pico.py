"""An emulated Pico of a virtual board: its files, and its flash chip as a file while it is on."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from hubodo.emulator.interpreters.rp2040.filesystem import make_flash, mirror_flash
from hubodo.emulator.interpreters.rp2040.image import find_image


@dataclass(frozen=True)
class PicoSettings:
    """Settings of an emulated Pico.

    Attributes
    ----------
    image, bootrom : see `image.find_image`; None for the default ones.
    miss_cycles : processor cycles per miss of the flash cache; an estimate.
    flash_image : file of the flash chip; used if it exists, else built from the files of the board. None for
        a temporary file, rebuilt at each power-on.
    meter_from : s of true time from which the activity of the processor is counted; None for never.
    profile : True to count for each function of the firmware too.
    """

    image: Path | None = None
    bootrom: Path | None = None
    miss_cycles: int = 50
    flash_image: Path | None = None
    meter_from: float | None = None
    profile: bool = False


class Pico:
    """Flash chip of an emulated Pico, built at power-on from the files in `folder`; it survives resets.

    Raise ImageMissing or FlashUnreadable.
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

    def runner_settings(self) -> dict[str, object]:
        """Return the settings of rp2040/runner.mjs."""
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
        """Copy the files in the chip to the folder of the board. Raise FlashUnreadable."""
        mirror_flash(self._flash, self._files)
