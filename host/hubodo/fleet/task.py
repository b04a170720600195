"""What is done with one log of many: fetched, hashed, examined, what was made of it put where it belongs."""

from __future__ import annotations

import hashlib
import io
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.calibration.file import hash_source
from hubodo.errors import HubodoError, InputError
from hubodo.fleet.identity import identity
from hubodo.fleet.listing import LogPlace
from hubodo.fleet.place import opened
from hubodo.fleet.quantities import quantities
from hubodo.safe_text import json_text
from hubodo.version import __version__

DONE, REFUSED, FAILED, KNOWN = "done", "refused", "failed", "known"
"""What became of a log: the analysis has a result; it cannot have one, whoever asks; something went wrong,
which another try may mend; an earlier run has it under another name.
"""


@dataclass(frozen=True)
class Analysis:
    """A verb with its options, as it goes to a worker.

    run: (verb, options, log, folder for files) -> the result as `--json` prints it. options: by name.
    files: bytes of what they name, by the path that stands in them. version: of hubodo.
    """

    verb: str
    options: Mapping[str, Any]
    files: Mapping[str, bytes]
    run: Callable[[str, Mapping[str, Any], Path, Path], Mapping[str, Any]]
    version: str = __version__

    @property
    def digest(self) -> str:
        """Hash of verb, version, options and the files they name."""
        known = {path: hashlib.sha256(data).hexdigest() for path, data in self.files.items()}
        said = {name: _hashed(value, known) for name, value in self.options.items()}
        return _digest(self.verb, self.version, json_text(said, sort=True))

    def key(self, log_hash: str) -> str:
        """Of the result for a log of this content."""
        return _digest(self.digest, log_hash)


def examine(place: LogPlace, analysis: Analysis, known: frozenset[str], output: str) -> dict[str, Any]:
    """A row of `finished.SCHEMA` for a log; never an error. known: keys of results that are there.

    output: URL of the folder in which files that the verb makes get a folder of their own.
    """
    began, cpu = time.perf_counter(), time.process_time()
    row: dict[str, Any] = {
        "verb": analysis.verb,
        "analysis": analysis.digest,
        "version": __version__,
        "log": place.url,
        "stamp": place.stamp,
        "size": place.size,
        "vehicle": place.folder,
        "quantities": [],
    }
    # Workers share the terminal of who started them: their progress is not for it.
    with tempfile.TemporaryDirectory(prefix="hubodo-") as scratch, redirect_stderr(io.StringIO()):
        try:
            row |= _examined(place, analysis, known, output, Path(scratch))
        except HubodoError as error:
            row |= {"status": REFUSED, "error": _words(error, scratch, place)}
        except MemoryError:
            row |= {"status": FAILED, "error": "not enough memory; give each worker more (--memory-limit)"}
        except Exception as error:  # noqa: BLE001 - one log of many must not end the others
            row |= {"status": FAILED, "error": _words(error, scratch, place)}
    return row | {"cpu": time.process_time() - cpu, "wall": time.perf_counter() - began}


def _examined(
    place: LogPlace, analysis: Analysis, known: frozenset[str], output: str, scratch: Path
) -> dict[str, Any]:
    if analysis.version != __version__:
        raise RuntimeError(f"this worker has hubodo {__version__}, the command {analysis.version}")
    log = _fetched(place, scratch)
    row: dict[str, Any] = {"sha256": hash_source(log)}
    row["key"] = analysis.key(row["sha256"])
    row |= identity(log, place.folder)
    if row["key"] in known:
        return row | {"status": KNOWN}
    made = scratch / "made"
    made.mkdir()
    try:
        result = dict(analysis.run(analysis.verb, _placed(analysis, scratch), log, made))
    except HubodoError as error:
        return row | {"status": REFUSED, "error": _words(error, str(scratch), place)}
    result |= {"log": place.url} if "log" in result else {}
    if any(made.iterdir()):
        folder = f"files/{analysis.verb.replace(' ', '-')}/{Path(place.name).stem}-{row['key'][:12]}"
        fs, path = opened(f"{output}/{folder}")
        fs.makedirs(path, exist_ok=True)
        fs.put(f"{made}/", path, recursive=True)
        result |= {"output": folder} if "output" in result else {}
        row["files"] = folder
    row["quantities"] = [item.__dict__ for item in quantities(analysis.verb, result)]
    return row | {"status": DONE, "result": json_text(result)}


def _fetched(place: LogPlace, scratch: Path) -> Path:
    """The log on this computer."""
    fs, path = opened(place.url)
    if "file" in fs.protocol:
        return Path(path)
    local = scratch / "log" / place.name
    local.parent.mkdir()
    fs.get(path, str(local), recursive=place.is_folder)
    return local


def _placed(analysis: Analysis, scratch: Path) -> dict[str, Any]:
    """The options with the files that they name on this computer."""
    places = {}
    for number, (path, data) in enumerate(analysis.files.items()):
        places[path] = scratch / str(number) / Path(path).name
        places[path].parent.mkdir()
        places[path].write_bytes(data)
    return {
        name: places.get(str(value), value) if isinstance(value, Path) else value
        for name, value in analysis.options.items()
    }


def _words(error: Exception, scratch: str, place: LogPlace) -> str:
    """One line; a place that is gone with the task is called by the log's name."""
    text = str(error).replace(f"{scratch}/log/{place.name}", place.url).replace(scratch, "")
    text = " ".join(text.split())
    return text if isinstance(error, HubodoError) else f"{type(error).__name__}: {text}"


def _hashed(value: Any, known: Mapping[str, str]) -> Any:
    return known.get(str(value), str(value)) if isinstance(value, Path) else value


def _digest(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def read_files(options: Mapping[str, Any]) -> dict[str, bytes]:
    """The bytes of the files that options name. Raises InputError for one that cannot be read."""
    found = {}
    for value in options.values():
        if isinstance(value, Path):
            try:
                found[str(value)] = value.read_bytes()
            except OSError as error:
                raise InputError(f"{value}: {error.strerror}; check the path and rights") from None
    return found
