"""Read a log in any supported format: MCAP, rosbag, rosbag2, CSV folder or number file."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from hubodo.errors import InputError
from hubodo.log.bag import METADATA_FILE, open_bag
from hubodo.log.column_names import is_epoch
from hubodo.log.csv_folder import find_files, read_files, read_folder
from hubodo.log.csv_header import ForeignHeaderError
from hubodo.log.input_limits import check_regular
from hubodo.log.logfile import open_log
from hubodo.log.number_file import detect_file_kind, explain_conversion
from hubodo.log.number_recording import (
    InputFormat,
    convert_to_si,
    read_number_file,
    read_parquet_numbers,
)
from hubodo.log.parquet_table import has_columns, is_parquet
from hubodo.log.phone_folder import is_phone_folder, read_phone_folder
from hubodo.log.recording_reader import build_recording
from hubodo.log.recording_writer import write_recording
from hubodo.log.row_checks import drop_implausible_rows
from hubodo.log.source import MessageSource, is_hubodo_log
from hubodo.progress_callback import Progress
from hubodo.recording import NODE_COLUMNS, TABLE_FILE_COLUMNS, Recording, Table, is_node_file, split_high_g
from hubodo.units import NS_PER_S

_DEFAULT_FORMAT = InputFormat()
_TEXT_SUFFIXES = (".csv", ".tsv", ".txt")
_FUSE_RESULT = "fuse.json"


def read_log(
    path: Path,
    *,
    input_format: InputFormat = _DEFAULT_FORMAT,
    progress: Progress | None = None,
    keep_empty: bool = False,
) -> Recording:
    """Read a whole log into memory.

    Parameters
    ----------
    path : file or folder in any supported format.
    input_format : metadata given by the user (rate, unit, columns, topics) that the log lacks.
    progress : called with the current step and the fraction done.
    keep_empty : True returns the log unchanged. False omits empty tables and rows with implausible values,
        and reports each in `Recording.warnings`.

    Raises
    ------
    LogError, InputError : the log cannot be read; see the reader of its format.
    """
    recording = _read_any(path, input_format, progress)
    if keep_empty:
        return recording
    tables, notes = drop_implausible_rows(recording.files())
    non_empty = {name: table for name, table in tables.items() if len(table)}
    notes += [f"{name} has no rows; left out" for name in tables if name not in non_empty]
    if not notes:
        return recording
    special: dict[str, Any] = {name: non_empty.get(name) for name in TABLE_FILE_COLUMNS}
    nodes = {name: non_empty[name] for name in recording.nodes if name in non_empty}
    special["high_g"] = split_high_g(non_empty)[1]
    warnings = (*recording.warnings, *(f"{path}: {line}" for line in notes))
    return replace(recording, nodes=nodes, warnings=warnings, **special)


def _read_any(path: Path, input_format: InputFormat, progress: Progress | None) -> Recording:
    with open_source(path) as source:
        if source is not None:
            _refuse_rate(path, input_format)
            return convert_to_si(
                build_recording(source, input_format.topic_selection, progress=progress), input_format
            )
    if input_format.topic_selection.explicit:
        raise InputError(
            f"{path}: has no topics, so --topic does not apply; the name of a file is the name of its node: "
            "rename it, such as left.csv"
        )
    if path.is_dir():
        if is_phone_folder(path):
            return convert_to_si(read_phone_folder(path), input_format)
        try:
            return convert_to_si(read_folder(path, progress=progress), input_format)
        except ForeignHeaderError:
            return _read_foreign_folder(path, input_format)
    if is_parquet(path):
        if input_format.columns or not has_columns(path, NODE_COLUMNS):
            return read_parquet_numbers(path, input_format)
        return convert_to_si(read_files({path.name.split(".")[0]: path}, progress=progress), input_format)
    return read_number_file(path, detect_file_kind(path), input_format)


def _read_foreign_folder(path: Path, input_format: InputFormat) -> Recording:
    """Read a folder whose node files are of another program; dates become times on one clock."""
    files = find_files(path)
    parts = {name: _read_any(file, input_format, None) for name, file in files.items() if is_node_file(name)}
    others = {name: file for name, file in files.items() if not is_node_file(name)}
    recording = read_files(others) if others else Recording({})
    zeros_ns = [part.t_zero_ns for part in parts.values()]
    are_dates = is_epoch(min(zeros_ns) / NS_PER_S)
    origin_ns = min(zeros_ns) if are_dates else max(zeros_ns)
    nodes = {}
    for name, part in parts.items():
        (table,) = part.nodes.values()
        t = table.t + (part.t_zero_ns - origin_ns) / NS_PER_S if are_dates else table.t
        nodes[name] = Table({**table.columns, "t": t})
    warnings = tuple(line for part in parts.values() for line in part.warnings)
    return replace(recording, nodes=nodes, warnings=warnings, t_zero_ns=max(origin_ns, recording.t_zero_ns))


def _refuse_rate(path: Path, input_format: InputFormat) -> None:
    if input_format.rate is not None:
        raise InputError(
            f"{path}: its messages have times; omit --rate, which is in samples per second (the speed of "
            "`hubodo play` is --speed)"
        )


@contextmanager
def open_source(path: Path) -> Iterator[MessageSource | None]:
    """Open a log as a source of messages; yields None for a CSV folder or a number file, which have none."""
    if path.suffix == ".toml" and path.is_file():
        raise InputError(f"{path}: is a TOML file, and a log is due here; check the order of the arguments")
    file = find_mcap_file(path)
    if file is not None:
        with open_log(file) as log:
            yield log
    elif is_rosbag(path):
        with closing(open_bag(path)) as bag:
            yield bag
    else:
        yield None


@contextmanager
def open_as_mcap(path: Path, input_format: InputFormat = _DEFAULT_FORMAT) -> Iterator[Path]:
    """Yield the log as an MCAP file with hubodo's topics, converted to a temporary file where necessary."""
    file = find_mcap_file(path)
    if file is not None:
        _refuse_rate(path, input_format)
    if (
        file is not None
        and not input_format.units
        and not input_format.topic_selection.explicit
        and is_hubodo_mcap(file)
    ):
        yield file
        return
    with tempfile.TemporaryDirectory(prefix="hubodo-") as folder:
        converted = Path(folder) / f"{path.absolute().name}.mcap"
        write_recording(read_log(path, input_format=input_format, keep_empty=True), converted)
        yield converted


def is_hubodo_mcap(file: Path) -> bool:
    """Return True if hubodo wrote the MCAP file, or if it has no channels that reveal its writer."""
    with open_log(file) as log:
        if not log.streams:
            next(log.chunks(), None)  # some writers announce channels inside the chunks only
        return is_hubodo_log(log) or not log.streams


def find_mcap_file(path: Path) -> Path | None:
    """Return the MCAP file that a path refers to; None for a log in another format.

    A file of unknown format counts as MCAP: the MCAP reader gives the most useful error message.
    """
    check_regular(path)
    if not path.is_dir():
        if conversion := explain_conversion(path):
            raise InputError(f"{path}: is {conversion}")
        kind = detect_file_kind(path)
        is_mcap = kind in ("mcap", "unknown") and not is_parquet(path)
        if kind == "unknown" and path.suffix in _TEXT_SUFFIXES and path.is_file() and path.stat().st_size:
            raise InputError(f"{path}: holds no table of numbers; it needs a row of numbers for each sample")
        return path if is_mcap else None
    _check_folder_of_one_log(path)
    if not is_rosbag(path):
        return None
    files = sorted(path.glob("*.mcap"))
    if len(files) == 1:
        return files[0]
    if not files and not any(path.glob("*.db3*")) and not any(path.glob("*.mcap*")):
        raise InputError(
            f"{path}: a rosbag2 folder without an .mcap or .db3 file; give the file that holds the messages"
        )
    return None


def _check_folder_of_one_log(path: Path) -> None:
    """Raise InputError for a folder of several logs, and for one that `hubodo fuse` wrote."""
    if (path / _FUSE_RESULT).is_file() and not (path / METADATA_FILE).exists():
        raise InputError(
            f"{path}: holds the result of `hubodo fuse`, and a log is due here; "
            "`hubodo export` converts its track with --format tum, kitti, gpx, kml or geojson"
        )
    logs = sorted(path.glob("*.mcap"))
    if len(logs) > 1 and not is_rosbag(path) and not any(path.glob("*.csv*")):
        raise InputError(f"{path}: holds several logs; name one, such as {logs[0]}, or see `hubodo batch`")


def is_rosbag(path: Path) -> bool:
    """Return True for a rosbag: a file, or a folder with or (after a killed recorder) without metadata."""
    check_regular(path)
    if not path.is_dir():
        return detect_file_kind(path) in ("rosbag", "sqlite")
    if (path / METADATA_FILE).exists():
        return True
    parts = [*path.glob("*.db3"), *path.glob("*.mcap")]
    is_one_recording = len(parts) == 1 or all(part.name.startswith(f"{path.name}_") for part in parts)
    return bool(parts) and is_one_recording and not any(path.glob("*.csv*"))
