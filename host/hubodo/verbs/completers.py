"""What the shell offers while a command is typed: ports, logs, other files, nodes and effects."""

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
_LOGS = (".mcap", ".bag", ".db3", ".csv", ".csv.gz", ".mat", ".h5", ".hdf5", ".npy", ".npz")
_NOT_NODES = ("gnss", "heading", "reference", "table", "truth", "wheels")
_IMU_TOPIC = re.compile(r"/([^/]+)/imu")


def typed_words() -> list[str]:
    """What stands on the command line that the shell asks about, without the word that is being typed."""
    line, at = os.environ.get("COMP_LINE", ""), os.environ.get("COMP_POINT", "0")
    _, _, _, words, _ = split_line(line, int(at) if at.isdigit() else len(line))
    return words[1:]


def complete(parser: argparse.ArgumentParser, **options: Any) -> None:
    """Answers the shell on the descriptor that it gave, and ends the process; options: of `autocomplete`."""
    _equip(parser)
    autocomplete(parser, always_complete_options=False, default_completer=_Files(), **options)


def _equip(parser: argparse.ArgumentParser) -> None:
    """Gives each argument of a parser, and of those below it, what it can be completed with."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                _equip(below)
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
        return _Files(*_LOGS)
    for sign, endings in (
        ("TOML", (".toml",)),
        ("MODEL", (".toml",)),
        ("JSON", (".json",)),
        ("HTML", (".html",)),
    ):
        if metavar.upper().startswith(sign):
            return _Files(*endings)
    if action.type is Path or action.choices:
        return None
    return _nothing


def _nothing(prefix: str, **_more: object) -> list[str]:
    """For numbers and names that nobody can know: the names of files would only mislead."""
    return []


class _Files(BaseCompleter):
    """Folders, and files with one of these endings; without any, all."""

    def __init__(self, *endings: str) -> None:
        self._endings = endings

    def __call__(self, prefix: str, **_more: object) -> list[str]:
        folder, _, begun = prefix.rpartition("/")
        above = f"{folder}/" if "/" in prefix else ""
        try:
            entries = sorted(Path(above).expanduser().iterdir(), key=lambda entry: entry.name)
        except OSError:
            return []
        return [
            f"{above}{entry.name}{'/' if entry.is_dir() else ''}"
            for entry in entries
            if entry.name.startswith(begun)
            and (begun or not entry.name.startswith("."))
            and (entry.is_dir() or not self._endings or entry.name.lower().endswith(self._endings))
        ]


def _ports(prefix: str, **_more: object) -> list[str]:
    """Serial ports and their USB serial numbers, with the name that stands before `=`."""
    before, equals, _ = prefix.rpartition("=")
    found: list[str] = []
    for info in list_devices():
        found += [info.device] + ([info.serial_number] if info.serial_number else [])
    found += ["udp://0.0.0.0:", "socket://"]
    names = [] if equals else [f"{side}=" for side in NODE_IDS]
    return [*names, *(f"{before}{equals}{port}" for port in found)]


def _nodes(prefix: str, parsed_args: argparse.Namespace, **_more: object) -> list[str]:
    """The nodes of the log that was named, else the names that nodes usually have."""
    log = getattr(parsed_args, "log", None)
    logs = log if isinstance(log, list) else [log] if log is not None else []
    names = [name for path in logs for name in _nodes_of(Path(path))] or list(NODE_IDS)
    begun, comma, _ = prefix.rpartition(",")
    return [f"{begun}{comma}{name}" for name in names]


def _nodes_of(path: Path) -> Iterable[str]:
    if path.is_dir():
        names = {file.name.partition(".csv")[0] for file in path.iterdir() if ".csv" in file.name}
        return sorted(names - set(_NOT_NODES))
    try:
        with open_log(path) as log:
            topics = [_IMU_TOPIC.fullmatch(stream.topic) for stream in log.streams.values()]
    except (HubodoError, OSError):
        return ()
    return sorted({match[1] for match in topics if match is not None})


def _effects(prefix: str, **_more: object) -> list[str]:
    from hubodo.effects import EFFECTS

    return [effect.name for effect in EFFECTS]
