"""Read arrays of numbers from text, MATLAB, HDF5 and numpy files; the content decides the format."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.log.array_process import read_isolated
from hubodo.log.foreign_formats import CONVERSIONS, SHEET_SUFFIXES
from hubodo.log.input_limits import open_regular
from hubodo.log.number_text import read_text_table
from hubodo.log.numpy_file import read_numpy
from hubodo.log.text_rows import unmarked_utf16

FileKind = Literal["mcap", "rosbag", "sqlite", "text", "matlab", "hdf5", "numpy", "unknown"]
_MAGIC_BYTES: tuple[tuple[bytes, FileKind], ...] = (
    (b"\x89MCAP0\r\n", "mcap"),
    (b"#ROSBAG V2.0", "rosbag"),
    (b"SQLite format 3\0", "sqlite"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"\x93NUMPY", "numpy"),
    (b"PK\x03\x04", "numpy"),
    (b"\x1f\x8b", "text"),
    (codecs.BOM_UTF16_LE, "text"),
    (codecs.BOM_UTF16_BE, "text"),
    (b"MATLAB 5.0 MAT-file", "matlab"),
    (b"MATLAB 7.3 MAT-file", "hdf5"),
)
_MATLAB_4 = re.compile(rb"[\0-\x34]\0\0\0.{8}[\0\1]\0\0\0[\2-\x40]\0\0\0[A-Za-z][A-Za-z0-9_]*\0", re.DOTALL)
"""Little-endian header of a MATLAB 4 file: type, rows, columns, imaginary flag, length of the name, name."""
_ARRAY_READERS: Mapping[str, Callable[[Path, tuple[str, ...]], tuple[dict[str, Array], dict[str, str]]]] = {
    "numpy": read_numpy,
    "matlab": lambda path, names: read_isolated(path, "matlab", names),
    "hdf5": lambda path, names: read_isolated(path, "hdf5", names),
}
_MAX_LISTED_NAMES = 12  # names in an error message


@dataclass(frozen=True)
class NumberTable:
    """A table of numbers.

    Attributes
    ----------
    values : (N, C).
    names : names of the C columns, or empty.
    units : units by array name, as far as the file states them.
    notes : one line for each row that was left out.
    """

    values: Array
    names: tuple[str, ...]
    units: Mapping[str, str]
    notes: tuple[str, ...] = ()


def detect_file_kind(path: Path) -> FileKind:
    """Return the kind of a file from its first bytes; "unknown" if it is unreadable or of no known kind.

    Raises InputError for a pipe or a device.
    """
    try:
        with open_regular(path) as stream:
            head = stream.read(4096)
    except OSError:
        return "unknown"
    for magic, kind in _MAGIC_BYTES:
        if head.startswith(magic):
            return kind
    if _MATLAB_4.match(head):
        return "matlab"
    if unmarked_utf16(head):
        return "text"
    is_text = all(byte >= 32 or byte in b"\t\r\n" for byte in head) and any(
        byte in b"0123456789" for byte in head
    )
    return "text" if is_text else "unknown"


def explain_conversion(path: Path) -> str:
    """Return what a file of another program is and how it is converted, or ""; it may be missing."""
    try:
        with open_regular(path) as stream:
            head = stream.read(8)
    except OSError:
        return ""
    if path.suffix.lower() in SHEET_SUFFIXES:
        return "a workbook; save the sheet as CSV"
    if path.suffix.lower() in (".yaml", ".yml"):
        return "a file of settings, and a log is due here"
    return next((advice for magic, advice in CONVERSIONS.items() if head.startswith(magic)), "")


def read_numbers(path: Path, kind: FileKind, variable: str | None) -> NumberTable:
    """Read the table of a file. variable: names of the arrays to read, separated by commas.

    Raises InputError if the file is unreadable, has no numbers, or has several arrays and none is selected.
    """
    wanted = () if variable is None else tuple(name.strip() for name in variable.split(","))
    try:
        if kind == "text":
            values, columns, notes = read_text_table(path)
            return NumberTable(values, columns, {}, notes)
        arrays, units = _ARRAY_READERS[kind](path, wanted)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error}); check the file") from None
    return _join_arrays(path, arrays, units, wanted)


def _join_arrays(
    path: Path, arrays: Mapping[str, Array], units: Mapping[str, str], wanted: tuple[str, ...]
) -> NumberTable:
    """Join the wanted arrays, or all, as columns. Raises InputError if they differ in length."""
    present = format_names(f"{name} {' x '.join(map(str, it.shape))}" for name, it in arrays.items())
    if not arrays:
        raise InputError(f"{path}: holds no array of numbers")
    names = wanted or tuple(arrays)
    for name in names:
        if name not in arrays:
            raise InputError(f"{path}: holds no variable {name!r}; give --variable with one of: {present}")
    if len({len(arrays[name]) for name in names}) > 1:
        raise InputError(f"{path}: holds {present}; give --variable with one, or several of equal length")
    labels = []
    for name in names:
        width = arrays[name].shape[1]
        labels += [name] if width == 1 else [f"{name}[{k}]" for k in range(width)]
    return NumberTable(np.hstack([arrays[name] for name in names]), tuple(labels), units)


def format_names(names: Iterable[str]) -> str:
    """Return the first names as one text, with the number of the others."""
    listed = list(names)
    others = f" and {len(listed) - _MAX_LISTED_NAMES} more" if len(listed) > _MAX_LISTED_NAMES else ""
    return ", ".join(listed[:_MAX_LISTED_NAMES]) + others
