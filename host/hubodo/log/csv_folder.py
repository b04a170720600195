"""Read and write the CSV folder: a recording as one CSV or Parquet file per table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from hubodo.atomic_files import atomic_folder
from hubodo.errors import InputError
from hubodo.log import parquet_table
from hubodo.log.csv_table import ParsedFile, read_table, write_table
from hubodo.progress_callback import Progress
from hubodo.recording import (
    NODE_COLUMNS,
    TABLE_FILE_COLUMNS,
    Event,
    Recording,
    Table,
    file_columns,
    is_node_file,
    split_high_g,
)
from hubodo.safe_text import json_text

TableFormat = Literal["csv", "parquet"]
_HINT_DEPTHS = ("*/*.csv", "*/*/*.csv", "*/*/*/*.csv")
"""Where a CSV file is looked up for an error message."""
_OTHER_TEXT_SUFFIXES = (".txt", ".tsv", ".dat", ".log")
SUFFIXES = (".csv", ".csv.gz", ".parquet")


def read_folder(folder: Path, *, repair: bool = False, progress: Progress | None = None) -> Recording:
    """Read a folder of CSV or Parquet files.

    t_zero_ns is 0, or the whole seconds that shift a negative t to zero.

    Raises InputError (file, row, remedy) for each fault listed in README.md beside this file. With `repair`,
    faulty rows are dropped instead, and counted in `metadata["repaired"]` and in one event per file.
    """
    return read_files(find_files(folder), repair=repair, progress=progress)


def read_files(
    files: Mapping[str, Path], *, repair: bool = False, progress: Progress | None = None
) -> Recording:
    """Read the given files of a recording (path by table name) as `read_folder` does."""
    tables: dict[str, Table] = {}
    dropped: dict[str, dict[str, int]] = {}
    for number, (name, path) in enumerate(files.items()):
        if progress:
            progress(f"reading {path.name}", number / len(files))
        parsed = _read_file(path, file_columns(name)[0], repair, is_node=is_node_file(name))
        tables[name] = parsed.table
        if parsed.dropped:
            dropped[path.name] = dict(parsed.dropped)
    nodes = {name: table for name, table in tables.items() if is_node_file(name)}
    earliest = min(table.t[0] for table in tables.values() if len(table))
    t_zero_ns = max(0, -int(earliest // 1)) * 1_000_000_000
    events = tuple(
        Event(t_zero_ns, "repaired", name, _describe_repair(name, kinds), {"file": name, "dropped": kinds})
        for name, kinds in dropped.items()
    )
    metadata = {"source": "csv folder"}
    if repair:
        metadata["repaired"] = json_text(dropped)
    special: dict[str, Any] = {name: table for name, table in tables.items() if name in TABLE_FILE_COLUMNS}
    special["high_g"] = split_high_g(tables)[1]
    return Recording(nodes, events=events, metadata=metadata, t_zero_ns=t_zero_ns, **special)


def write_folder(
    recording: Recording, folder: Path, *, table_format: TableFormat = "csv", progress: Progress | None = None
) -> tuple[str, ...]:
    """Write the recording's tables and return the file names.

    Raises InputError if the folder is not empty, if there is no table, or if Parquet is requested and pyarrow
    is not installed. A failure leaves nothing behind.
    """
    if table_format == "parquet":
        parquet_table.require_pyarrow()
    write = parquet_table.write_table if table_format == "parquet" else write_table
    files = recording.files()
    if not files:
        raise InputError("the log holds no table to export: no node, no GNSS, no truth; see hubodo info")
    for name in files:
        if "/" in name or "\0" in name or name in ("", ".", ".."):
            raise InputError(f"node {name!r} cannot be the name of a file; export the other nodes by hand")
    with atomic_folder(folder) as part:
        names = []
        for number, (name, table) in enumerate(files.items()):
            if progress:
                progress(f"writing {name}.{table_format}", number / len(files))
            names.append(f"{name}.{table_format}")
            write(part / names[-1], table)
    return tuple(names)


def find_files(folder: Path) -> dict[str, Path]:
    """Return CSV and Parquet files by table name, nodes first, in alphabetical order."""
    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder; give the folder that holds the CSV files")
    path_by_name: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        suffix = next((it for it in SUFFIXES if path.name.lower().endswith(it)), "")
        name = path.name[: len(path.name) - len(suffix)]
        if not suffix or not name:
            continue
        if name in path_by_name:
            raise InputError(
                f"{folder}: holds both {path_by_name[name].name} and {path.name}; remove one of them"
            )
        path_by_name[name] = path
    if not any(map(is_node_file, path_by_name)) and "wheels" not in path_by_name:
        deeper = next(iter(sorted(it for depth in _HINT_DEPTHS for it in folder.glob(depth))), None)
        text = next(
            (it for it in sorted(folder.iterdir()) if it.suffix.lower() in _OTHER_TEXT_SUFFIXES), None
        )
        hint = f"; rename {text.name} to {text.stem}.csv" if text is not None else ""
        hint = f"; give the file of another program alone, such as {deeper}" if deeper else hint
        raise InputError(
            f"{folder}: holds no node; it needs at least one file <node>.csv with the columns "
            f"{','.join(NODE_COLUMNS)}, or wheels.csv{hint}"
        )
    return dict(sorted(path_by_name.items(), key=lambda item: item[0] in TABLE_FILE_COLUMNS))


def _read_file(path: Path, required: tuple[str, ...], repair: bool, *, is_node: bool) -> ParsedFile:
    read = parquet_table.read_table if path.suffix.lower() == ".parquet" else read_table
    parsed = read(path, required, repair=repair)
    if is_node and not len(parsed.table):
        lost = sum(parsed.dropped.values())
        raise InputError(
            f"{path}: no rows remain"
            + (f" after dropping {lost} ({_format_counts(parsed.dropped)})" if lost else " below the header")
            + "; correct the file or remove it"
        )
    return parsed


def _describe_repair(name: str, kinds: dict[str, int]) -> str:
    return f"{name}: dropped {sum(kinds.values())} rows on import: {_format_counts(kinds)}"


def _format_counts(kinds: Any) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in kinds.items())
