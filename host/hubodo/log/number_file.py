"""Arrays of numbers in files of other programs: text, MATLAB, HDF5, numpy; the content says which."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError

Kind = Literal["mcap", "rosbag", "sqlite", "text", "matlab", "hdf5", "numpy", "unknown"]
FloatArray = NDArray[np.float64]

_GZIP = b"\x1f\x8b"
_MAGIC: tuple[tuple[bytes, Kind], ...] = (
    (b"\x89MCAP0\r\n", "mcap"),
    (b"#ROSBAG V2.0", "rosbag"),
    (b"SQLite format 3\0", "sqlite"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"\x93NUMPY", "numpy"),
    (b"PK\x03\x04", "numpy"),
    (_GZIP, "text"),
)
_MATLAB, _MATLAB_HDF5 = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
_DELIMITERS = (",", ";", "\t")
_MOST_COLUMNS = 32
_ROOM, _RATIO = 1 << 28, 1000


@dataclass(frozen=True)
class Numbers:
    """A table. values: (N, C); names: of the columns, or empty; units: by name where the file tells."""

    values: FloatArray
    names: tuple[str, ...]
    units: Mapping[str, str]


def kind_of(path: Path) -> Kind:
    """What a file is by its first bytes; unknown where it cannot be read or is nothing of these."""
    try:
        with path.open("rb") as stream:
            head = stream.read(4096)
    except OSError:
        return "unknown"
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            return kind
    if head.startswith((_MATLAB, _MATLAB_HDF5)):
        return "matlab" if head.startswith(_MATLAB) else "hdf5"
    words = all(byte >= 32 or byte in b"\t\r\n" for byte in head) and any(
        byte in b"0123456789" for byte in head
    )
    return "text" if words else "unknown"


def read_numbers(path: Path, kind: Kind, variable: str | None) -> Numbers:
    """The table of a file. variable: names of the arrays to take, separated by commas.

    Raises InputError: not readable, nothing numeric in it, several variables and none chosen.
    """
    try:
        if kind == "text":
            return _text(path)
        arrays, units = {"matlab": _matlab, "hdf5": _hdf5, "numpy": _numpy}[kind](path)
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); check the file") from None
    return _chosen(path, arrays, units, variable)


def _text(path: Path) -> Numbers:
    content = path.read_bytes()
    content = gzip.decompress(content) if content.startswith(_GZIP) else content
    lines = content.decode("utf-8-sig").splitlines()
    rows = [k for k, line in enumerate(lines) if line.strip() and line.lstrip()[0] not in "#%"]
    if not rows:
        raise InputError(f"{path}: holds no numbers")
    first = lines[rows[0]]
    delimiter = next((mark for mark in _DELIMITERS if mark in first), None)
    cells = [cell.strip().strip('"') for cell in first.split(delimiter)]
    names = () if all(_is_number(cell) for cell in cells) else tuple(cells)
    rows = rows[1:] if names else rows
    if not rows:
        raise InputError(f"{path}: no row below the header")
    try:
        values = np.loadtxt([lines[k] for k in rows], delimiter=delimiter, ndmin=2, comments=None)
    except ValueError:
        raise InputError(_fault(path, lines, rows, delimiter, len(cells))) from None
    return Numbers(values, names, {})


def _fault(path: Path, lines: list[str], rows: list[int], delimiter: str | None, width: int) -> str:
    for k in rows:
        cells = lines[k].split(delimiter)
        if len(cells) != width:
            return f"{path}: row {k + 1} has {len(cells)} columns, the first {width}; correct the row"
        bad = next((cell.strip() for cell in cells if not _is_number(cell)), None)
        if bad is not None:
            return f"{path}: row {k + 1}: {bad[:40]!r} is not a number; correct the row, or write nan"
    return f"{path}: its rows are no numbers"


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _matlab(path: Path) -> tuple[dict[str, FloatArray], dict[str, str]]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path, simplify_cells=True)
    except (MatReadError, ValueError, TypeError) as error:
        raise InputError(f"{path}: a damaged MATLAB file ({error}); save it again") from None
    arrays: dict[str, FloatArray] = {}

    def collect(name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                collect(f"{name}.{key}" if name else key, inner)
        elif _numeric(value) and not name.startswith("__"):
            arrays[name] = _upright(np.asarray(value, np.float64))

    collect("", content)
    return arrays, {}


def _hdf5(path: Path) -> tuple[dict[str, FloatArray], dict[str, str]]:
    import h5py

    arrays: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    # No packing of measured numbers is a thousandfold; what is declared and never written is not read.
    room = _ROOM + _RATIO * path.stat().st_size

    def collect(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf" and item.size > 1 and item.ndim <= 2:
            if 8 * item.size > room:
                raise InputError(
                    f"{path}: {name} claims {item.size} numbers, more than the file can hold; save it again"
                )
            arrays[name] = _upright(np.asarray(item[()], np.float64))
            said = next((item.attrs[key] for key in ("unit", "units") if key in item.attrs), None)
            if said is not None:
                units[name] = said.decode() if isinstance(said, bytes) else str(said)

    with h5py.File(path, "r") as file:
        file.visititems(collect)
    return arrays, units


def _numpy(path: Path) -> tuple[dict[str, FloatArray], dict[str, str]]:
    try:
        content = np.load(path, allow_pickle=False)
        found = {path.stem: content} if isinstance(content, np.ndarray) else dict(content)
    except (ValueError, MemoryError) as error:
        raise InputError(f"{path}: cannot be read by numpy ({error}); save plain arrays") from None
    return {name: _upright(np.asarray(it, np.float64)) for name, it in found.items() if _numeric(it)}, {}


def _numeric(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.size > 1 and value.ndim <= 2


def _upright(values: FloatArray) -> FloatArray:
    """(N, C): a row for each sample, as MATLAB writes columns and HDF5 gives them back as rows."""
    if values.ndim == 1:
        return values[:, None]
    lying = values.shape[0] < values.shape[1] and values.shape[0] <= _MOST_COLUMNS
    return values.T.copy() if lying else values


def _chosen(
    path: Path, arrays: dict[str, FloatArray], units: dict[str, str], variable: str | None
) -> Numbers:
    """The arrays asked for, or all of them where they are as long, beside each other."""
    there = ", ".join(f"{name} {' x '.join(map(str, it.shape))}" for name, it in arrays.items())
    if not arrays:
        raise InputError(f"{path}: holds no array of numbers")
    names = list(arrays) if variable is None else [name.strip() for name in variable.split(",")]
    for name in names:
        if name not in arrays:
            raise InputError(f"{path}: holds no variable {name!r}; say --variable with one of: {there}")
    if len({len(arrays[name]) for name in names}) > 1:
        raise InputError(f"{path}: holds {there}; say --variable with one, or several of one length")
    labels = []
    for name in names:
        width = arrays[name].shape[1]
        labels += [name] if width == 1 else [f"{name}[{k}]" for k in range(width)]
    return Numbers(np.hstack([arrays[name] for name in names]), tuple(labels), units)
