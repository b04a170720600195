"""Main program of the subprocess that decodes one MATLAB or HDF5 file for `array_process`."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import InputError
from hubodo.log.array_shapes import is_number_table
from hubodo.safe_text import json_text

ArrayEntry = tuple[str, tuple[int, ...], str | None, Callable[[], NDArray[Any]]]
"""Name, shape and unit of an array, and the function that reads its values."""

_MAX_COMPRESSION_RATIO = 1100  # expanded / stored bytes; deflate, the tightest filter of HDF5, reaches 1032
_MAX_UNWRITTEN_BYTES = 1 << 28  # size of a dataset that was declared and never written


def main() -> None:
    """Decode the file named in the first argument (JSON) and write its arrays to standard output."""
    order = json.loads(sys.argv[1])
    path, wanted = Path(order["path"]), order["wanted"]
    decode = {"matlab": _iterate_matlab, "hdf5": _iterate_hdf5}[order["kind"]]
    import_libraries(order["kind"])
    limit_process(order["memory"], order["cpu"])
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # output of a library must not mix with the arrays
    try:
        for name, shape, unit, read in decode(path, wanted, order["memory"]):
            sent = not wanted or name in wanted
            values = np.ascontiguousarray(read(), np.float64) if sent else None
            header = {"name": name, "shape": shape, "unit": unit, "sent": sent}
            out.write(json_text(header).encode() + b"\n")
            if values is not None:
                out.write(values.data)
    except MemoryError:
        limit = f"{order['memory'] / 1e6:.0f} MB"
        _send_error(out, f"needs more than {limit} to decode; raise --max-memory if the file is genuine")
    except InputError as error:
        _send_error(out, str(error))
    except Exception as error:  # noqa: BLE001 - whatever the libraries raise at damaged bytes
        _send_error(out, f"cannot be read ({type(error).__name__}: {str(error)[:200]}); save it again")
    out.flush()


def _send_error(out: Any, text: str) -> None:
    out.write(json_text({"error": text}).encode() + b"\n")


def import_libraries(kind: str) -> None:
    """Import the library for this kind of file, before memory is limited."""
    if kind == "matlab":
        import scipy.io.matlab  # noqa: F401
    else:
        import h5py  # noqa: F401


def limit_process(memory: int, cpu: int) -> None:
    """Limit this process to `memory` bytes beyond its present size and `cpu` seconds of processor time."""
    try:
        import resource
    except ImportError:  # Windows has no such limits; the separate process still protects its caller
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 1))
    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
    except (OSError, ValueError):  # no /proc: macOS, whose kernel does not enforce this limit anyway
        return
    limit = pages * resource.getpagesize() + memory
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _iterate_matlab(path: Path, wanted: list[str], memory: int) -> Iterator[ArrayEntry]:
    from scipy.io import loadmat

    content = loadmat(path, simplify_cells=True)
    pending: list[tuple[str, Any]] = list(reversed(content.items()))
    while pending:
        name, value = pending.pop()
        if isinstance(value, dict):
            pending += [(f"{name}.{key}", inner) for key, inner in reversed(value.items())]
        elif (
            isinstance(value, np.ndarray)
            and not name.startswith("__")
            and is_number_table(value.dtype, value.shape)
        ):
            yield name, value.shape, None, lambda value=value: value  # type: ignore[misc]


def _iterate_hdf5(path: Path, wanted: list[str], memory: int) -> Iterator[ArrayEntry]:
    import h5py

    with h5py.File(path, "r") as file:
        datasets: list[tuple[str, Any]] = []

        def collect(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and is_number_table(item.dtype, item.shape or ()):
                datasets.append((name, item))

        file.visititems(collect)
        _reject_external_links(file, wanted)
        claimed = 0
        for name, item in datasets:
            if wanted and name not in wanted:
                yield name, item.shape, None, lambda: np.zeros(0)
                continue
            if item.is_virtual or item.external is not None:
                raise InputError(
                    f"{name} is stored in another file, which is not followed; copy it into this one"
                )
            claimed += 8 * item.size
            stored = item.id.get_storage_size()
            if 8 * item.size > _MAX_UNWRITTEN_BYTES + _MAX_COMPRESSION_RATIO * stored or claimed > memory:
                raise InputError(
                    f"{name} claims {item.size} numbers: the file holds {stored} bytes of them, the limit is "
                    f"{memory / 1e6:.0f} MB; save it again, or raise --max-memory if the file is genuine"
                )
            yield name, item.shape, _read_unit(item), lambda item=item: item[()]  # type: ignore[misc]


def _reject_external_links(file: Any, wanted: list[str]) -> None:
    """Raise InputError if a requested array is a link to another file."""
    import h5py

    links: list[tuple[str, str]] = []

    def collect(name: str, link: Any) -> None:
        if isinstance(link, h5py.ExternalLink):
            links.append((name, link.filename))

    file.visititems_links(collect)
    for name, target in links:
        if not wanted or any(one.startswith(name) for one in wanted):
            raise InputError(
                f"{name} is a link to another file ({target}), which is not followed; copy it into this one"
            )


def _read_unit(item: Any) -> str | None:
    value = next((item.attrs[key] for key in ("unit", "units") if key in item.attrs), None)
    if value is None:
        return None
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


if __name__ == "__main__":
    main()
