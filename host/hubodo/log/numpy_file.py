"""Read arrays from .npy and .npz files after checking their headers against the memory limit."""

from __future__ import annotations

import io
import math
import os
import zipfile
import zlib
from pathlib import Path
from tokenize import TokenError
from typing import IO, cast

import numpy as np
from numpy.lib import format as npy

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.log.array_shapes import is_number_table, placeholder_rows, samples_as_rows
from hubodo.log.input_limits import MemoryBudget, open_regular

_ZIP_MAGIC = b"PK\x03\x04"
_NUMPY_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""The methods that numpy writes; other methods may allocate gigabytes at once."""
_HEADER_ERRORS = (ValueError, TypeError, SyntaxError, RecursionError, MemoryError, OverflowError, TokenError)
"""Errors that numpy raises for a damaged header."""
_ZIP_ERRORS = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError)


def read_numpy(path: Path, wanted: tuple[str, ...]) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the numeric arrays of a .npy or .npz file by name, (N, C) each, and no units.

    wanted: names of the arrays to read, () for all. Raises InputError for a damaged file, Python objects or
    arrays beyond the memory limit; OSError.
    """
    with open_regular(path) as file:
        stream = io.BufferedReader(cast(io.RawIOBase, file))
        budget = MemoryBudget(path)
        if stream.peek(4)[:4] == _ZIP_MAGIC:
            return _read_npz(path, stream, wanted, budget), {}
        remaining = os.fstat(file.fileno()).st_size
        array = _read_npy(path, path.stem, stream, budget, remaining)
        return ({} if array is None else {path.stem: array}), {}


def _read_npz(
    path: Path, stream: IO[bytes], wanted: tuple[str, ...], budget: MemoryBudget
) -> dict[str, Array]:
    arrays: dict[str, Array] = {}
    try:
        with zipfile.ZipFile(stream) as archive:
            entries = archive.infolist()
            names = {entry.filename for entry in entries}
            if len(names) < len(entries):
                raise InputError(f"{path}: holds two arrays of one name; save it again with numpy.savez")
            for entry in entries:
                name = entry.filename.removesuffix(".npy")
                if name == entry.filename:
                    continue
                if entry.compress_type not in _NUMPY_COMPRESSIONS:
                    raise InputError(f"{path}: {name} is compressed as numpy does not; save it again")
                with archive.open(entry) as member:
                    array = _read_npy(path, name, member, budget, None, keep=not wanted or name in wanted)
                if array is not None:
                    arrays[name] = array
    except _ZIP_ERRORS as error:
        raise InputError(f"{path}: a damaged .npz file ({error}); save it again") from None
    if not arrays and (others := [name for name in sorted(names) if not name.endswith((".npy", "/"))]):
        content = ", ".join(others[:3]) + (f" and {len(others) - 3} more" if len(others) > 3 else "")
        raise InputError(f"{path}: is an archive with {content}; unpack it, and give a file or the folder")
    return arrays


def _read_npy(
    path: Path,
    name: str,
    stream: IO[bytes],
    budget: MemoryBudget,
    file_bytes: int | None,
    *,
    keep: bool = True,
) -> Array | None:
    """Read one array; return None if it is not a table of numbers.

    file_bytes: size of the file, None if compressed. keep: False reads only the shape.
    """
    try:
        version = npy.read_magic(stream)
        read_header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}[version]
        shape, is_fortran, dtype = read_header(stream)
    except KeyError:
        return None  # version 3 is for structured arrays
    except _HEADER_ERRORS as error:
        reason = str(error).partition(":")[0][:80] or type(error).__name__
        raise InputError(f"{path}: the header of {name[:80]} is damaged ({reason}); save it again") from None
    if dtype.hasobject:
        raise InputError(f"{path}: {name} holds Python objects, which are not read; save plain arrays")
    if not is_number_table(dtype, shape):
        return None
    count = math.prod(shape)
    if not keep:
        return placeholder_rows(shape)
    budget.claim(count * (dtype.itemsize + 8), f"the array {name}")
    n_bytes = count * dtype.itemsize
    if file_bytes is not None and n_bytes > file_bytes - stream.tell():
        raise InputError(
            f"{path}: its header claims {count} numbers, which need {n_bytes} bytes, but "
            f"{file_bytes - stream.tell()} bytes follow; save it again"
        )
    data = stream.read(n_bytes)
    if len(data) < n_bytes:
        raise InputError(f"{path}: {name} claims {count} numbers, its data end earlier; save it again")
    values = np.frombuffer(data, dtype).reshape(shape, order="F" if is_fortran else "C")
    return samples_as_rows(values.astype(np.float64))
