"""The recordings in a folder, and the pages made of them: nothing outside it can be named.

No path is ever built from what a visitor sends: a name is looked up among those that the folder has.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PAGES = "pages"
"""Folder beside the recordings: one of the recording's name for each, with what was made of it."""

_DEEPEST = 3
_MOST_MODEL_BYTES = 1 << 20


@dataclass(frozen=True)
class RecordingFile:
    """A recording. name: its path from the folder, with slashes."""

    name: str
    path: Path
    size: int
    changed: float


class Library:
    """folder: may be written to by others at any time; what is a link, or no plain file, is not there."""

    def __init__(self, folder: Path, models: dict[str, Path] | None = None) -> None:
        """models: for `gap`, besides the TOML files of the folder."""
        self.folder = folder
        self._models = models or {}

    def entries(self) -> list[RecordingFile]:
        """The newest first."""
        found = [
            RecordingFile(name, path, info.st_size, info.st_mtime)
            for name, path, info in self._files(".mcap", self.folder, "", _DEEPEST)
        ]
        return sorted(found, key=lambda entry: (-entry.changed, entry.name))

    def find(self, name: str) -> RecordingFile | None:
        """The recording of that name."""
        return next((entry for entry in self.entries() if entry.name == name), None)

    def models(self) -> dict[str, Path]:
        """By name, what may be a model file."""
        there = self._files(".toml", self.folder, "", 1)
        return {
            **{name: path for name, path, info in there if info.st_size < _MOST_MODEL_BYTES},
            **self._models,
        }

    def made(self, entry: RecordingFile, *parts: str) -> Path:
        """Where something made of a recording is, or will be. parts: known names, no visitor's."""
        return self.folder.joinpath(PAGES, *entry.name.split("/"), *parts)

    def fresh(self, entry: RecordingFile, *parts: str) -> Path | None:
        """The same where it is there and no older than the recording."""
        path = self.made(entry, *parts)
        try:
            info = path.lstat()
        except OSError:
            return None
        inside = path.resolve().is_relative_to(self.folder.resolve())
        return path if stat.S_ISREG(info.st_mode) and inside and info.st_mtime >= entry.changed else None

    def as_json(self, current: Path | None) -> dict[str, Any]:
        """For the page. current: the file that is being written."""
        now = None if current is None else current.resolve()
        return {
            "folder": self.folder.resolve().name,
            "models": sorted(self.models()),
            "recordings": [
                {
                    "name": entry.name,
                    "size": entry.size,
                    "changed": round(entry.changed, 1),
                    "current": entry.path.resolve() == now,
                    "report": self.fresh(entry, "report.html") is not None,
                    "gap": self.fresh(entry, "gap", "report.html") is not None,
                }
                for entry in self.entries()
            ],
        }

    def _files(
        self, suffix: str, folder: Path, prefix: str, depth: int
    ) -> Iterator[tuple[str, Path, os.stat_result]]:
        try:
            entries = list(os.scandir(folder))
        except OSError:
            return
        for entry in entries:
            try:
                if entry.name.startswith("."):
                    continue
                if entry.is_file(follow_symlinks=False) and entry.name.endswith(suffix):
                    yield prefix + entry.name, Path(entry.path), entry.stat(follow_symlinks=False)
                elif entry.is_dir(follow_symlinks=False) and depth > 1 and (prefix or entry.name != PAGES):
                    yield from self._files(suffix, Path(entry.path), f"{prefix}{entry.name}/", depth - 1)
            except OSError:  # gone meanwhile
                continue
