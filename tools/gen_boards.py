"""Compile the firmware for each board, and write the table of boards in firmware/README.md."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "host"))

from generated import fill, write_or_check  # noqa: E402
from hubodo.emulator.board.models import MODELS  # noqa: E402
from hubodo.flash.image import build_image  # noqa: E402

FIRMWARE = ROOT / "firmware"
README = FIRMWARE / "README.md"
# By the end of the name that MicroPython reports.
ARCHITECTURES = {
    "RP2040": "armv6m",
    "RP2350": "armv7emsp",
    "ESP32": "xtensawin",
    "ESP32S3": "xtensawin",
    "ESP32C3": "rv32imc",
}
EXECUTED = {"Raspberry Pi Pico with RP2040": "on an emulated RP2040, with the MicroPython of real boards"}
"""What executes the machine code; `tests/chip` and `make chip` do it."""


def boards_table() -> str:
    """Return the table; raises ImageError if a file of the firmware does not compile for a board."""
    lines = ["| board, as MicroPython reports it | compiled for | machine code executed |", "|---|---|---|"]
    for model in MODELS.values():
        architecture = ARCHITECTURES[model.machine.rpartition(" ")[2]]
        build_image(FIRMWARE, architecture)
        lines.append(
            f"| {model.machine} | {architecture} | {EXECUTED.get(model.machine, 'no: compiled only')} |"
        )
    return "\n".join(lines)


def generate_files() -> dict[Path, str]:
    """Return the README with its table."""
    return {README: fill(README.read_text(encoding="utf-8"), {"boards": boards_table()})}


if __name__ == "__main__":
    sys.exit(write_or_check(generate_files, ROOT, "tools/gen_boards.py", __doc__, None))
