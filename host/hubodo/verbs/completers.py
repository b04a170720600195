"""Shell completion of ports, logs, other files, nodes and effects."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from argcomplete import autocomplete
from argcomplete.completers import BaseCompleter
from argcomplete.lexers import split_line

from hubodo.errors import HubodoError
from hubodo.ingest.link.ports import list_devices
from hubodo.log.logfile import open_log
from hubowire.messages import NODE_IDS

Completer = Callable[..., list[str]]
_COMPLETED_LOG_SUFFIXES = (".mcap", ".bag", ".db3", ".csv", ".csv.gz", ".mat", ".h5", ".hdf5", ".npy", ".npz")
_NON_NODE_FILES = ("gnss", "heading", "reference", "table", "truth", "wheels")
_IMU_TOPIC = re.compile(r"/([^/]+)/imu")


def typed_words() -> list[str]:
    """Return the complete words on the command line that the shell is completing."""
    line, cursor = os.environ.get("COMP_LINE", ""), os.environ.get("COMP_POINT", "0")
    _, _, _, words, _ = split_line(line, int(cursor) if cursor.isdigit() else len(line))
    return words[1:]


def complete_command(parser: argparse.ArgumentParser, **options: Any) -> None:
    """Answer the shell on its descriptor and end the process; options are those of `autocomplete`."""
    _attach_completers(parser)
    autocomplete(parser, always_complete_options=False, default_completer=_Files(), **options)


def _attach_completers(parser: argparse.ArgumentParser) -> None:
    """Attach a completer to each argument of a parser and of its subparsers."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for subparser in action.choices.values():
                _attach_completers(subparser)
        elif (completer := _completer(action)) is not None:
            action.completer = completer  # type: ignore[attr-defined]


def _completer(action: argparse.Action) -> Completer | None:
    metavar = str(action.metavar or "")
    if action.dest in ("accept", "reject", "explain"):
        return _effects
    if metavar == "PORT":
        return _ports
    if action.dest in ("node", "nodes"):
        return _nodes
    if metavar in ("LOG", "FILE.mcap"):
        return _Files(*_COMPLETED_LOG_SUFFIXES)
    for prefix, suffixes in (
        ("TOML", (".toml",)),
        ("MODEL", (".toml",)),
        ("JSON", (".json",)),
        ("HTML", (".html",)),
    ):
        if metavar.upper().startswith(prefix):
            return _Files(*suffixes)
    if action.type is Path or action.choices:
        return None
    return _no_completions


def _no_completions(prefix: str, **_more: object) -> list[str]:
    """Return no completions, for numbers and free names: file names would mislead."""
    return []


class _Files(BaseCompleter):
    """A completer for folders and for files with one of the given suffixes, or for all files."""

    def __init__(self, *suffixes: str) -> None:
        self._suffixes = suffixes

    def __call__(self, prefix: str, **_more: object) -> list[str]:
        folder, _, start = prefix.rpartition("/")
        parent = f"{folder}/" if "/" in prefix else ""
        try:
            entries = sorted(Path(parent).expanduser().iterdir(), key=lambda entry: entry.name)
        except OSError:
            return []
        return [
            f"{parent}{entry.name}{'/' if entry.is_dir() else ''}"
            for entry in entries
            if entry.name.startswith(start)
            and (start or not entry.name.startswith("."))
            and (entry.is_dir() or not self._suffixes or entry.name.lower().endswith(self._suffixes))
        ]


def _ports(prefix: str, **_more: object) -> list[str]:
    """Return serial ports and USB serial numbers, each with the prefix `NAME=` if one was typed."""
    before, equals, _ = prefix.rpartition("=")
    ports: list[str] = []
    for info in list_devices():
        ports += [info.device] + ([info.serial_number] if info.serial_number else [])
    ports += ["udp://0.0.0.0:", "ble://hubodo-", "socket://"]
    names = [] if equals else [f"{side}=" for side in NODE_IDS]
    return [*names, *(f"{before}{equals}{port}" for port in ports)]


def _nodes(prefix: str, parsed_args: argparse.Namespace, **_more: object) -> list[str]:
    """Return the nodes of the log on the command line, else the usual node names."""
    log = getattr(parsed_args, "log", None)
    logs = log if isinstance(log, list) else [log] if log is not None else []
    names = [name for path in logs for name in _nodes_of(Path(path))] or list(NODE_IDS)
    chosen, comma, _ = prefix.rpartition(",")
    return [f"{chosen}{comma}{name}" for name in names]


def _nodes_of(path: Path) -> Iterable[str]:
    if path.is_dir():
        names = {file.name.partition(".csv")[0] for file in path.iterdir() if ".csv" in file.name}
        return sorted(names - set(_NON_NODE_FILES))
    try:
        with open_log(path) as log:
            topics = [_IMU_TOPIC.fullmatch(stream.topic) for stream in log.streams.values()]
    except (HubodoError, OSError):
        return ()
    return sorted({match[1] for match in topics if match is not None})


def _effects(prefix: str, **_more: object) -> list[str]:
    from hubodo.effects import EFFECTS

    return [effect.name for effect in EFFECTS]
