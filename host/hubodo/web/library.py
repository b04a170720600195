"""The recordings of a folder and the files derived from them; nothing outside can be named.

No path is built from what a visitor sends: names are looked up among those in the folder.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hubodo.web.derived_files import PAGES, DerivedFiles

_MAX_FOLDER_DEPTH = 3
_MAX_MODEL_BYTES = 1 << 20


@dataclass(frozen=True)
class RecordingFile:
    """A recording in the folder.

    Attributes
    ----------
    name
        Path relative to the folder, with slashes, as written by `shown_name`.
    path
        Path of the file.
    parts
        Components of the relative path, as in the file system.
    size
        Size, bytes.
    changed
        Time of the last change, s since 1970.
    """

    name: str
    path: Path
    parts: tuple[str, ...]
    size: int
    changed: float


class RecordingLibrary:
    """The recordings of a folder; links and special files are ignored, as others may write to it."""

    def __init__(self, folder: Path, models: dict[str, Path] | None = None) -> None:
        """Open a folder; `models` are model files for `gap` besides the TOML files of the folder."""
        self.folder = folder
        self.derived = DerivedFiles(folder)
        self._models = models or {}

    def list_recordings(self) -> list[RecordingFile]:
        """Return the recordings, the newest first."""
        recordings = [
            RecordingFile(shown_name("/".join(parts)), path, parts, info.st_size, info.st_mtime)
            for parts, path, info in self._files(".mcap", self.folder, (), _MAX_FOLDER_DEPTH)
        ]
        return sorted(recordings, key=lambda entry: (-entry.changed, entry.name))

    def find_recording(self, name: str) -> RecordingFile | None:
        """Return the recording of that name, or None."""
        return next((entry for entry in self.list_recordings() if entry.name == name), None)

    def list_models(self) -> dict[str, Path]:
        """Return possible model files by name."""
        files = self._files(".toml", self.folder, (), 1)
        return {
            **{shown_name(parts[0]): path for parts, path, info in files if info.st_size < _MAX_MODEL_BYTES},
            **self._models,
        }

    def as_json(self, current: Path | None) -> dict[str, Any]:
        """Return the JSON form for the page; `current` is the file that is being written."""
        current_path = None if current is None else current.resolve()
        return {
            "folder": shown_name(self.folder.resolve().name),
            "models": sorted(self.list_models()),
            "recordings": [
                {
                    "name": entry.name,
                    "size": entry.size,
                    "changed": round(entry.changed, 1),
                    "current": entry.path.resolve() == current_path,
                    "report": self.derived.is_fresh((*entry.parts, "report.html"), entry.changed),
                    "gap": self.derived.is_fresh((*entry.parts, "gap", "report.html"), entry.changed),
                }
                for entry in self.list_recordings()
            ],
        }

    def _files(
        self, suffix: str, folder: Path, parents: tuple[str, ...], depth: int
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
                    yield (*parents, entry.name), Path(entry.path), entry.stat(follow_symlinks=False)
                elif entry.is_dir(follow_symlinks=False) and depth > 1 and (parents or entry.name != PAGES):
                    yield from self._files(suffix, Path(entry.path), (*parents, entry.name), depth - 1)
            except OSError:  # deleted in the meantime
                continue


def shown_name(name: str) -> str:
    """Return a file name as printable text; bytes other than UTF-8 are written as in `\\xff`.

    Unprintable characters are escaped too, and backslashes doubled, so that different names stay different.
    """
    raw = name.replace("\\", "\\\\").encode("utf-8", "surrogateescape")
    text = raw.decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
