"""`hubodo example`: write the files that the documents use into a folder."""

from __future__ import annotations

import argparse
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from hubodo.demo.example_files import LOGS, TEXTS, write_example_files
from hubodo.errors import InputError
from hubodo.pages.console import print_table
from hubodo.progress import progress_line

EXAMPLE = "hubodo example try && cd try && hubodo fuse drive.mcap -o out/"

_MEANINGS = {
    "vehicle.toml": "vehicle file: sizes and the mounting of two nodes",
    "model.toml": "model file: the vehicle, sensor noise and inputs",
    "leaning.toml": "the model with a cambered left wheel, for gap",
    "bench.toml": "one node on a bench, for --drive poses",
    "c.toml": "calibration of that node",
    "drive.mcap": "a simulated drive of 60 s with its true path",
    "night.mcap": "ten minutes at standstill, for allan and warmup",
}


@dataclass(frozen=True)
class ExampleFiles:
    """The files that were written.

    Attributes
    ----------
    folder
        Their folder.
    files
        Their names.
    """

    folder: str
    files: tuple[str, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the JSON result."""
        return asdict(self)

    def render(self, console: Console) -> None:
        """Print each file with its meaning."""
        print_table(
            console, ("file", "content"), [(name, _MEANINGS[name]) for name in self.files], self.folder
        )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo example`."""
    parser.add_argument(
        "folder", type=Path, metavar="DIR", help="folder for the files, created if it is missing"
    )
    parser.add_argument("--force", action="store_true", help="replace existing files of the same names")


def run(args: argparse.Namespace) -> ExampleFiles:
    """Write the files.

    Returns
    -------
    ExampleFiles
        Folder and names.

    Raises
    ------
    InputError
        If the folder is a file, or one of the files exists.
    """
    folder: Path = args.folder
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; name a folder")
    existing = next((folder / name for name in (*TEXTS, *LOGS) if (folder / name).exists()), None)
    if existing is not None and not args.force:
        raise InputError(f"{existing}: exists already; choose another name, or give --force to replace it")
    folder.mkdir(parents=True, exist_ok=True)
    with progress_line() as show:
        names = write_example_files(folder, show)
    return ExampleFiles(str(folder), tuple(names))
