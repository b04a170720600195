"""Decode MATLAB and HDF5 files in a subprocess with limited memory and processor time.

Their libraries are written in C and trust the file: a damaged one may crash them, keep them busy for ever or
make them allocate any claimed size. Only the subprocess ends then, and the caller raises a one-line error.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log.array_shapes import placeholder_rows, samples_as_rows
from hubodo.log.input_limits import MemoryBudget, check_regular, limit_bytes
from hubodo.safe_text import json_text

_CPU_BASE_S = 15  # s of processor time granted to any file
_CPU_S_PER_BYTE = 1 / 3e6  # s; HDF5 gzip expands at 100 MB/s; this allows for slow computers
_MAX_PROTOCOL_LINE_BYTES = 1 << 24  # bytes; a line of the protocol contains the name of an array
_FORMAT_NAMES = {"matlab": "MATLAB", "hdf5": "HDF5"}


def read_isolated(
    path: Path, kind: str, wanted: tuple[str, ...]
) -> tuple[dict[str, NDArray[np.float64]], dict[str, str]]:
    """Return the numeric arrays of a MATLAB or HDF5 file by name, (N, C) each, and their units by name.

    wanted: names of the arrays to read, () for all; of the others only the shape is read. Raises InputError
    for a damaged file, data in another file, or more memory or processor time than allowed; OSError.
    """
    check_regular(path)
    size = path.stat().st_size
    budget = MemoryBudget(path)
    order = {
        "path": str(path.absolute()),
        "kind": kind,
        "wanted": wanted,
        # The subprocess holds an array twice during conversion; this process holds it once more.
        "memory": limit_bytes() // 2,
        "cpu": int(_CPU_BASE_S + _CPU_S_PER_BYTE * size),
    }
    # -P: a module in the current folder must not shadow the installed one.
    command = [sys.executable, "-P", "-m", "hubodo.log.array_decoder", json_text(order)]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors)
        assert process.stdout is not None
        try:
            arrays, units, error = _receive_arrays(process.stdout, budget)
        except BaseException:
            process.kill()
            raise
        finally:
            process.stdout.close()
            code = process.wait()
    if error is not None:
        raise InputError(f"{path}: {error}")
    if code:
        raise InputError(
            f"{path}: a damaged {_FORMAT_NAMES[kind]} file ({_explain_exit_code(code)}); save it again"
        )
    return arrays, units


def _receive_arrays(
    stream: IO[bytes], budget: MemoryBudget
) -> tuple[dict[str, NDArray[np.float64]], dict[str, str], str | None]:
    """Read the output of `array_decoder`: arrays by name, units by name, and an error text or None."""
    arrays: dict[str, NDArray[np.float64]] = {}
    units: dict[str, str] = {}
    while line := stream.readline(_MAX_PROTOCOL_LINE_BYTES):
        message: dict[str, Any] = json.loads(line)
        if "error" in message:
            return {}, {}, message["error"]
        name, shape = message["name"], tuple(message["shape"])
        if message["sent"]:
            count = int(np.prod(shape))
            budget.claim(8 * count, f"the array {name}")
            values = np.empty(count)
            if stream.readinto(values.data.cast("B")) < values.nbytes:  # type: ignore[attr-defined]
                break
            arrays[name] = samples_as_rows(values.reshape(shape))
        else:
            arrays[name] = placeholder_rows(shape)
        if message["unit"] is not None:
            units[name] = message["unit"]
    return arrays, units, None


def _explain_exit_code(code: int) -> str:
    """Describe why the subprocess ended, from its exit code."""
    if code > 0:
        return f"its reader failed with code {code}"
    name = signal.Signals(-code).name if -code in list(signal.Signals) else str(-code)
    return "reading it takes too long" if name in ("SIGXCPU", "SIGKILL") else f"its reader ended with {name}"
