"""MATLAB and HDF5 files decoded in a process of its own, limited in memory and processor time.

Their libraries are written in C and read what a file claims: a damaged file may crash them, keep them busy
for ever or have them allocate what it names. The process then ends, and the caller says so in one line.
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
from hubodo.log.array_shapes import as_rows, shape_only
from hubodo.log.input_limits import MemoryBudget, check_regular, limit_bytes
from hubodo.safe_text import json_text

_CPU_BASE = 15  # s of processor time for any file
_CPU_PER_BYTE = 1 / 3e6  # s; gzip in HDF5 is unpacked at some 100 MB/s, this allows for slow computers
_LONGEST_LINE = 1 << 24  # bytes of one line of the protocol; names of arrays are in it
_NAMES = {"matlab": "MATLAB", "hdf5": "HDF5"}


def read_isolated(
    path: Path, kind: str, wanted: tuple[str, ...]
) -> tuple[dict[str, NDArray[np.float64]], dict[str, str]]:
    """Read the arrays of numbers in a MATLAB or HDF5 file by name, and their units.

    wanted: which, () for all; of the others only the shape is read. Raises InputError: damaged, data in
    another file, more than the memory limit, more processor time than a file of its size can need. OSError.
    """
    check_regular(path)
    size = path.stat().st_size
    budget = MemoryBudget(path)
    order = {
        "path": str(path.absolute()),
        "kind": kind,
        "wanted": wanted,
        # The process holds an array twice while it is converted; here it is held once more.
        "memory": limit_bytes() // 2,
        "cpu": int(_CPU_BASE + _CPU_PER_BYTE * size),
    }
    # -P: a module of the folder in which hubodo was started must not replace one that is meant.
    command = [sys.executable, "-P", "-m", "hubodo.log.array_decoder", json_text(order)]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors)
        assert process.stdout is not None
        try:
            arrays, units, error = _receive(process.stdout, budget)
        except BaseException:
            process.kill()
            raise
        finally:
            process.stdout.close()
            code = process.wait()
    if error is not None:
        raise InputError(f"{path}: {error}")
    if code:
        raise InputError(f"{path}: a damaged {_NAMES[kind]} file ({_cause(code)}); save it again")
    return arrays, units


def _receive(
    stream: IO[bytes], budget: MemoryBudget
) -> tuple[dict[str, NDArray[np.float64]], dict[str, str], str | None]:
    """Read what `array_decoder` writes: arrays and units by name, and an error or None."""
    arrays: dict[str, NDArray[np.float64]] = {}
    units: dict[str, str] = {}
    while line := stream.readline(_LONGEST_LINE):
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
            arrays[name] = as_rows(values.reshape(shape))
        else:
            arrays[name] = shape_only(shape)
        if message["unit"] is not None:
            units[name] = message["unit"]
    return arrays, units, None


def _cause(code: int) -> str:
    """Return why the process ended, from its exit code."""
    if code > 0:
        return f"its reader failed with code {code}"
    name = signal.Signals(-code).name if -code in list(signal.Signals) else str(-code)
    return "it takes too long to read" if name in ("SIGXCPU", "SIGKILL") else f"its reader ended with {name}"
