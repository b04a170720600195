"""A log in any of its forms: MCAP, rosbag, rosbag2 or CSV folder, one file of numbers."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from hubodo.errors import InputError
from hubodo.log.convert import write_recording
from hubodo.log.csv_folder import Progress, read_folder
from hubodo.log.foreign import LogForm, in_si, read_number_file, read_rosbag
from hubodo.log.mcap import read_recording
from hubodo.log.number_file import kind_of
from hubodo.log.sound_rows import believable_tables
from hubodo.recording import RESERVED, Recording

_ROSBAG2 = "metadata.yaml"
_AS_IT_IS = LogForm()


def read_log(
    path: Path, *, form: LogForm = _AS_IT_IS, progress: Progress | None = None, keep_empty: bool = False
) -> Recording:
    """Read a whole log. form: what the user says of it, for what it does not say itself.

    keep_empty: all as it stands; else tables without a row and rows that nothing can have measured are left
    out and told. Raises LogError or InputError as
    `read_recording`, `read_folder`, `read_number_file` and `read_rosbag` do.
    """
    recording = _read(path, form, progress)
    if keep_empty:
        return recording
    tables, said = believable_tables(recording.files())
    kept = {name: table for name, table in tables.items() if len(table)}
    said += [f"nothing in {name}; left out" for name in tables if name not in kept]
    if not said:
        return recording
    special: dict[str, Any] = {name: kept.get(name) for name in RESERVED}
    nodes = {name: kept[name] for name in recording.nodes if name in kept}
    warnings = (*recording.warnings, *(f"{path}: {line}" for line in said))
    return replace(recording, nodes=nodes, warnings=warnings, **special)


def _read(path: Path, form: LogForm, progress: Progress | None) -> Recording:
    file = mcap_file(path)
    if file is not None:
        return in_si(read_recording(file, progress=progress), form)
    if path.is_dir() and not is_rosbag2(path):
        return in_si(read_folder(path, progress=progress), form)
    kind = "rosbag" if path.is_dir() else kind_of(path)
    return in_si(read_rosbag(path), form) if kind == "rosbag" else read_number_file(path, kind, form)


@contextmanager
def as_mcap(path: Path, form: LogForm = _AS_IT_IS) -> Iterator[Path]:
    """The log as an MCAP file; of any other form one that is gone afterwards."""
    file = mcap_file(path)
    if file is not None and not form.units:
        yield file
        return
    with tempfile.TemporaryDirectory(prefix="hubodo-") as folder:
        made = Path(folder) / f"{path.absolute().name}.mcap"
        write_recording(read_log(path, form=form, keep_empty=True), made)
        yield made


def mcap_file(path: Path) -> Path | None:
    """The MCAP file that a path means; None for a log of another form.

    A file that is nothing known is taken as one, for the reader of MCAP says best what is wrong with it.
    """
    if not path.is_dir():
        return path if kind_of(path) in ("mcap", "unknown") else None
    if not is_rosbag2(path):
        return None
    files = sorted(path.glob("*.mcap"))
    if len(files) == 1:
        return files[0]
    if files:
        raise InputError(f"{path}: a rosbag2 folder in {len(files)} parts; name one: {files[0].name}, ...")
    if not any(path.glob("*.db3")):
        raise InputError(
            f"{path}: a rosbag2 folder without an .mcap or .db3 file; give the file that holds the messages"
        )
    return None


def is_rosbag2(folder: Path) -> bool:
    """Whether a folder is a rosbag2."""
    return (folder / _ROSBAG2).exists()
