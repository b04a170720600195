"""A log in any of its forms: MCAP, rosbag, rosbag2 or CSV folder, one file of numbers."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from hubodo.errors import InputError
from hubodo.log.bag import METADATA_FILE, open_bag
from hubodo.log.claims import check_regular
from hubodo.log.convert import write_recording
from hubodo.log.csv_folder import Progress, read_files, read_folder
from hubodo.log.foreign import LogForm, in_si, read_number_file
from hubodo.log.logfile import open_log
from hubodo.log.mcap import recording_of
from hubodo.log.number_file import kind_of
from hubodo.log.parquet_table import is_parquet
from hubodo.log.sound_rows import believable_tables
from hubodo.log.source import Source, is_ours
from hubodo.recording import TABLE_FILE_COLUMNS, Recording

_AS_IT_IS = LogForm()


def read_log(
    path: Path, *, form: LogForm = _AS_IT_IS, progress: Progress | None = None, keep_empty: bool = False
) -> Recording:
    """Read a whole log. form: what the user says of it, for what it does not say itself.

    keep_empty: all as it stands; else tables without a row and rows that nothing can have measured are left
    out and told. Raises LogError or InputError as the readers of those files do.
    """
    recording = _read(path, form, progress)
    if keep_empty:
        return recording
    tables, said = believable_tables(recording.files())
    kept = {name: table for name, table in tables.items() if len(table)}
    said += [f"nothing in {name}; left out" for name in tables if name not in kept]
    if not said:
        return recording
    special: dict[str, Any] = {name: kept.get(name) for name in TABLE_FILE_COLUMNS}
    nodes = {name: kept[name] for name in recording.nodes if name in kept}
    warnings = (*recording.warnings, *(f"{path}: {line}" for line in said))
    return replace(recording, nodes=nodes, warnings=warnings, **special)


def _read(path: Path, form: LogForm, progress: Progress | None) -> Recording:
    with open_source(path) as source:
        if source is not None:
            return in_si(recording_of(source, form.choice, progress=progress), form)
    if form.choice.said:
        raise InputError(f"{path}: has no topics; leave --topic out")
    if path.is_dir():
        return in_si(read_folder(path, progress=progress), form)
    if is_parquet(path):
        return in_si(read_files({path.name.split(".")[0]: path}, progress=progress), form)
    return read_number_file(path, kind_of(path), form)


@contextmanager
def open_source(path: Path) -> Iterator[Source | None]:
    """The messages of a log; None where it has none: a CSV folder or a file of numbers."""
    file = mcap_file(path)
    if file is not None:
        with open_log(file) as log:
            yield log
    elif is_bag(path):
        with closing(open_bag(path)) as bag:
            yield bag
    else:
        yield None


@contextmanager
def as_mcap(path: Path, form: LogForm = _AS_IT_IS) -> Iterator[Path]:
    """The log as an MCAP file with hubodo's topics; of any other form one that is gone afterwards."""
    file = mcap_file(path)
    if file is not None and not form.units and not form.choice.said and has_our_topics(file):
        yield file
        return
    with tempfile.TemporaryDirectory(prefix="hubodo-") as folder:
        made = Path(folder) / f"{path.absolute().name}.mcap"
        write_recording(read_log(path, form=form, keep_empty=True), made)
        yield made


def has_our_topics(file: Path) -> bool:
    """Whether hubodo wrote an MCAP file, or nobody can tell."""
    with open_log(file) as log:
        if not log.streams:
            next(log.chunks(), None)  # some writers announce channels inside the chunks only
        return is_ours(log) or not log.streams


def mcap_file(path: Path) -> Path | None:
    """The MCAP file that a path means; None for a log of another form.

    A file that is nothing known is taken as one, for the reader of MCAP says best what is wrong with it.
    """
    check_regular(path)
    if not path.is_dir():
        return path if kind_of(path) in ("mcap", "unknown") and not is_parquet(path) else None
    if not is_bag(path):
        return None
    files = sorted(path.glob("*.mcap"))
    if len(files) == 1:
        return files[0]
    if not files and not any(path.glob("*.db3*")) and not any(path.glob("*.mcap*")):
        raise InputError(
            f"{path}: a rosbag2 folder without an .mcap or .db3 file; give the file that holds the messages"
        )
    return None


def is_bag(path: Path) -> bool:
    """Whether a path is a rosbag: a file, or a folder, which a killed recorder leaves without metadata."""
    check_regular(path)
    if not path.is_dir():
        return kind_of(path) in ("rosbag", "sqlite")
    if (path / METADATA_FILE).exists():
        return True
    parts = [*path.glob("*.db3"), *path.glob("*.mcap")]
    of_one = len(parts) == 1 or all(part.name.startswith(f"{path.name}_") for part in parts)
    return bool(parts) and of_one and not any(path.glob("*.csv*"))
