"""Examine one log of a batch: fetch, hash, run the verb, store its files and return a row."""

from __future__ import annotations

import hashlib
import io
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hubodo.calibration.file import hash_source
from hubodo.errors import HubodoError, InputError
from hubodo.fleet.listing import LogLocation
from hubodo.fleet.quantities import extract_quantities
from hubodo.fleet.storage import open_file_system
from hubodo.ingest.replay.odometry_setup import read_odometry_setup
from hubodo.log.any_log import open_source
from hubodo.log.logfile import Log
from hubodo.safe_text import json_text
from hubodo.version import __version__

DONE, REFUSED, FAILED, KNOWN = "done", "refused", "failed", "known"
"""Status of a log: it has a result; the verb refused it, so a retry is useless; it failed, so a retry may
help; the result of a log with the same content is already known.
"""
_EARLIEST_START_NS = datetime(2000, 1, 1, tzinfo=UTC).timestamp() * 1e9
"""ns since 1970; an earlier time comes from a clock that was never set."""


@dataclass(frozen=True)
class Analysis:
    """A verb with its options, as sent to a worker.

    Attributes
    ----------
    options : options of the verb by name.
    files : contents of the files that the options name, by path.
    run : (verb, options, log, output folder) -> result as printed by `--json`.
    version : version of hubodo.
    """

    verb: str
    options: Mapping[str, Any]
    files: Mapping[str, bytes]
    run: Callable[[str, Mapping[str, Any], Path, Path], Mapping[str, Any]]
    version: str = __version__

    @property
    def digest(self) -> str:
        """Hash of verb, version, options and the files that they name."""
        hashes = {path: hashlib.sha256(data).hexdigest() for path, data in self.files.items()}
        options = {name: _hash_value(value, hashes) for name, value in self.options.items()}
        return _digest(self.verb, self.version, json_text(options, sort=True))

    def result_key(self, log_hash: str) -> str:
        """Return the key of the result for a log with this content hash."""
        return _digest(self.digest, log_hash)


def examine_log(
    location: LogLocation, analysis: Analysis, known_keys: frozenset[str], output: str
) -> dict[str, Any]:
    """Return a row of `result_store.SCHEMA` for a log; errors become part of the row.

    known_keys: keys of stored results. output: URL of the folder for the files that the verb writes.
    """
    start, cpu = time.perf_counter(), time.process_time()
    row: dict[str, Any] = {
        "verb": analysis.verb,
        "analysis": analysis.digest,
        "version": __version__,
        "log": location.url,
        "stamp": location.stamp,
        "size": location.size,
        "vehicle": location.folder,
        "quantities": [],
    }
    # Workers share the terminal of the command, which shows its own progress.
    with tempfile.TemporaryDirectory(prefix="hubodo-") as scratch, redirect_stderr(io.StringIO()):
        try:
            row |= _run_analysis(location, analysis, known_keys, output, Path(scratch))
        except HubodoError as error:
            row |= {"status": REFUSED, "error": _describe_error(error, scratch, location)}
        except MemoryError:
            row |= {"status": FAILED, "error": "not enough memory; give each worker more (--memory-limit)"}
        except Exception as error:  # noqa: BLE001 - one log of many must not end the others
            row |= {"status": FAILED, "error": _describe_error(error, scratch, location)}
    return row | {"cpu": time.process_time() - cpu, "wall": time.perf_counter() - start}


def _run_analysis(
    location: LogLocation, analysis: Analysis, known_keys: frozenset[str], output: str, scratch: Path
) -> dict[str, Any]:
    if analysis.version != __version__:
        raise RuntimeError(f"this worker has hubodo {__version__}, the command {analysis.version}")
    log = _fetch_log(location, scratch)
    row: dict[str, Any] = {"sha256": hash_source(log)}
    row["key"] = analysis.result_key(row["sha256"])
    row |= _read_identity(log, location.folder)
    if row["key"] in known_keys:
        return row | {"status": KNOWN}
    output_folder = scratch / "made"
    output_folder.mkdir()
    try:
        result = dict(analysis.run(analysis.verb, _write_option_files(analysis, scratch), log, output_folder))
    except HubodoError as error:
        return row | {"status": REFUSED, "error": _describe_error(error, str(scratch), location)}
    result |= {"log": location.url} if "log" in result else {}
    if any(output_folder.iterdir()):
        folder = f"files/{analysis.verb.replace(' ', '-')}/{Path(location.name).stem}-{row['key'][:12]}"
        fs, path = open_file_system(f"{output}/{folder}")
        fs.makedirs(path, exist_ok=True)
        fs.put(f"{output_folder}/", path, recursive=True)
        result |= {"output": folder} if "output" in result else {}
        row["files"] = folder
    row["quantities"] = [item.__dict__ for item in extract_quantities(analysis.verb, result)]
    return row | {"status": DONE, "result": json_text(result)}


def _fetch_log(location: LogLocation, scratch: Path) -> Path:
    """Return the log as a local path, downloaded if necessary."""
    fs, path = open_file_system(location.url)
    if "file" in fs.protocol:
        return Path(path)
    local = scratch / "log" / location.name
    local.parent.mkdir()
    fs.get(path, str(local), recursive=location.is_folder)
    return local


def _write_option_files(analysis: Analysis, scratch: Path) -> dict[str, Any]:
    """Write the files of the options to the scratch folder and return options with local paths."""
    local_paths = {}
    for number, (path, data) in enumerate(analysis.files.items()):
        local_paths[path] = scratch / str(number) / Path(path).name
        local_paths[path].parent.mkdir()
        local_paths[path].write_bytes(data)
    return {
        name: local_paths.get(str(value), value) if isinstance(value, Path) else value
        for name, value in analysis.options.items()
    }


def _describe_error(error: Exception, scratch: str, location: LogLocation) -> str:
    """Describe an error in one line, with the name of the log instead of temporary paths."""
    text = str(error).replace(f"{scratch}/log/{location.name}", location.url).replace(scratch, "")
    text = " ".join(text.split())
    return text if isinstance(error, HubodoError) else f"{type(error).__name__}: {text}"


def _hash_value(value: Any, hashes: Mapping[str, str]) -> Any:
    return hashes.get(str(value), str(value)) if isinstance(value, Path) else value


def _digest(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def read_option_files(options: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the contents of the files that options name, by path. Raises InputError if unreadable."""
    contents = {}
    for value in options.values():
        if isinstance(value, Path):
            try:
                contents[str(value)] = value.read_bytes()
            except OSError as error:
                raise InputError(f"{value}: {error.strerror}; check the path and rights") from None
    return contents


def _read_identity(log: Path, folder: str) -> dict[str, Any]:
    """Return `vehicle` (name in the attached vehicle file, else the folder) and `start` (UTC or None).

    Unreadable logs raise no error here; the analysis of the log reports them.
    """
    name, start = folder, None
    try:
        with open_source(log) as source:
            if source is not None and source.t_zero_ns is not None and source.t_zero_ns > _EARLIEST_START_NS:
                start = datetime.fromtimestamp(source.t_zero_ns / 1e9, UTC)
            if isinstance(source, Log) and (vehicle := read_odometry_setup(source).vehicle) is not None:
                name = vehicle.name or folder
    except (HubodoError, OSError, ValueError, OverflowError):
        pass
    return {"vehicle": name, "start": start}
