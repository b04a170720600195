"""The one rule for existing outputs: refused without --force, replaced with it when the verb succeeds."""

from __future__ import annotations

import argparse
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hubodo.errors import InputError
from hubodo.unit_systems import UNIT_SYSTEMS, parse_unit_system

_OUTPUT_DESTINATIONS = "output_destinations"
_PAGE_SUFFIXES = (".html", ".htm")
_OWN_FILES = "own_files"
_TABLE_SUFFIXES = (".csv", ".gz", ".parquet", ".mcap", ".db3", ".yaml")
"""Suffixes of the files in a folder that `export` and `simulate` write; no other folder is replaced."""


def html_path(text: str) -> Path:
    """Parse the value of an option that names a page; refuse one that does not end in .html."""
    if Path(text).suffix.lower() not in _PAGE_SUFFIXES:
        raise argparse.ArgumentTypeError(
            f"{text}: a page is HTML; name a file that ends in .html (browsers print it as PDF)"
        )
    return Path(text)


def add_calibration_output(parser: argparse.ArgumentParser) -> None:
    """Add --output, the calibration file to which a calibration adds its results."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="TOML",
        help="calibration file to create or extend",
    )


def add_units_option(parser: argparse.ArgumentParser) -> None:
    """Add --units, which `cli` applies to the tables and pages of a verb."""
    parser.add_argument(
        "--units",
        type=_unit_system,
        metavar="|".join(UNIT_SYSTEMS),
        help="units of tables and pages: common (°/h, °/√h, mg, ppm, arc-min) or si (default: as each table "
        "has them, often both); --json is in SI units",
    )


def _unit_system(text: str) -> str:
    try:
        return parse_unit_system(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(f"{error}; the unit of a file is --unit") from None


def add_force_option(
    parser: argparse.ArgumentParser, *destinations: str, own_files: Sequence[str] = ()
) -> None:
    """Add --force.

    destinations: names of the options whose existing file or folder it replaces. own_files: names of the
    files that the verb writes into a folder.
    """
    parser.add_argument("--force", action="store_true", help="replace existing results")
    parser.set_defaults(**{_OUTPUT_DESTINATIONS: destinations, _OWN_FILES: own_files})


@contextmanager
def replace_outputs(args: argparse.Namespace) -> Iterator[None]:
    """Apply the rule to the outputs of a verb while it runs; after a failure the earlier ones are back.

    Raises InputError for an existing output without --force, and for one that is an input of the verb.
    """
    names = getattr(args, _OUTPUT_DESTINATIONS, ())
    inputs = [value for name, value in vars(args).items() if name not in names]
    existing = [path for name in names if (path := _as_regular(getattr(args, name, None))) is not None]
    for path in existing:
        if not args.force:
            raise InputError(f"{path}: exists already; choose another name, or give --force to replace it")
        _check_replaceable(path, inputs, getattr(args, _OWN_FILES, ()))
    aside = [(path, _move_aside(path)) for path in existing]
    try:
        yield
    except BaseException:
        for path, old in aside:
            if not path.exists():
                old.rename(path)
        raise
    finally:
        for _, old in aside:
            shutil.rmtree(old.parent, ignore_errors=True)


def _as_regular(path: Path | None) -> Path | None:
    """Return the path of an existing file or folder with content; /dev/null and an empty folder are free."""
    if path is None or not (path.is_file() or path.is_dir()):
        return None
    return None if path.is_dir() and not any(path.iterdir()) else path


def _check_replaceable(path: Path, inputs: Sequence[Any], own_files: Sequence[str]) -> None:
    """Raise InputError for a link, an input of the verb, and a folder that holds other files."""
    if path.is_symlink():
        raise InputError(f"{path}: is a link; remove it or name another")
    for value in inputs:
        for given in value if isinstance(value, list) else [value]:
            if not isinstance(given, Path) or not given.exists():
                continue
            if given.samefile(path) or path.resolve() in given.resolve().parents:
                raise InputError(f"{path}: is or holds the input {given}; name another output")
    if path.is_dir():
        foreign = next(
            (
                file
                for file in path.iterdir()
                if file.is_dir() or not (file.suffix in _TABLE_SUFFIXES or file.name in own_files)
            ),
            None,
        )
        if foreign is not None:
            raise InputError(f"{path}: holds {foreign.name}, which hubodo did not write; name another folder")


def _move_aside(path: Path) -> Path:
    """Move a file or folder into a private folder beside it, and return where it is now."""
    folder = Path(tempfile.mkdtemp(prefix=".hubodo-", suffix=".part", dir=path.absolute().parent))
    try:
        return path.rename(folder / path.name)
    except OSError:
        with suppress(OSError):
            folder.rmdir()
        raise
