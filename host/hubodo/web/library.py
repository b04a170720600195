"""The recordings in a folder, and the pages made of them: nothing outside it can be named.

No path is ever built from what a visitor sends: a name is looked up among those that the folder has.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.web.derived_files import PAGES, DerivedFiles

_DEEPEST = 3
_MOST_MODEL_BYTES = 1 << 20


@dataclass(frozen=True)
class RecordingFile:
    """A recording. name: its path from the folder, with slashes, as `shown_name` writes it."""

    name: str
    path: Path
    parts: tuple[str, ...]
    """Of the path from the folder, as the file system has them."""
    size: int
    changed: float


class Library:
    """folder: may be written to by others at any time; what is a link, or no plain file, is not there."""

    def __init__(self, folder: Path, models: dict[str, Path] | None = None) -> None:
        """models: for `gap`, besides the TOML files of the folder."""
        self.folder = folder
        self.derived = DerivedFiles(folder)
        self._models = models or {}

    def entries(self) -> list[RecordingFile]:
        """The newest first."""
        found = [
            RecordingFile(shown_name("/".join(parts)), path, parts, info.st_size, info.st_mtime)
            for parts, path, info in self._files(".mcap", self.folder, (), _DEEPEST)
        ]
        return sorted(found, key=lambda entry: (-entry.changed, entry.name))

    def find(self, name: str) -> RecordingFile | None:
        """The recording of that name."""
        return next((entry for entry in self.entries() if entry.name == name), None)

    def models(self) -> dict[str, Path]:
        """By name, what may be a model file."""
        there = self._files(".toml", self.folder, (), 1)
        return {
            **{shown_name(parts[0]): path for parts, path, info in there if info.st_size < _MOST_MODEL_BYTES},
            **self._models,
        }

    def as_json(self, current: Path | None) -> dict[str, Any]:
        """For the page. current: the file that is being written."""
        now = None if current is None else current.resolve()
        return {
            "folder": shown_name(self.folder.resolve().name),
            "models": sorted(self.models()),
            "recordings": [
                {
                    "name": entry.name,
                    "size": entry.size,
                    "changed": round(entry.changed, 1),
                    "current": entry.path.resolve() == now,
                    "report": self.derived.is_fresh((*entry.parts, "report.html"), entry.changed),
                    "gap": self.derived.is_fresh((*entry.parts, "gap", "report.html"), entry.changed),
                }
                for entry in self.entries()
            ],
        }

    def _files(
        self, suffix: str, folder: Path, above: tuple[str, ...], depth: int
    ) -> Iterator[tuple[tuple[str, ...], Path, os.stat_result]]:
        try:
            entries = list(os.scandir(folder))
        except OSError:
            return
        for entry in entries:
            try:
                if entry.name.startswith("."):
                    continue
                if entry.is_file(follow_symlinks=False) and entry.name.endswith(suffix):
                    yield (*above, entry.name), Path(entry.path), entry.stat(follow_symlinks=False)
                elif entry.is_dir(follow_symlinks=False) and depth > 1 and (above or entry.name != PAGES):
                    yield from self._files(suffix, Path(entry.path), (*above, entry.name), depth - 1)
            except OSError:  # gone meanwhile
                continue


def shown_name(name: str) -> str:
    """Return a name of the file system as text that can be sent: other bytes than UTF-8 as in `\\xff`.

    What cannot be printed is escaped too, and a backslash written twice, so that no two names become one.
    """
    raw = name.replace("\\", "\\\\").encode("utf-8", "surrogateescape")
    text = raw.decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
