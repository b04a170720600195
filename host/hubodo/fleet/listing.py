"""Which logs are meant by folders, globs and URLs, and by what each can be known again unread."""

from __future__ import annotations

import posixpath
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fsspec.core import has_magic

from hubodo.errors import InputError
from hubodo.fleet.place import opened, reached, url_of

_LOGS = (".mcap", ".bag", ".db3")
_CSV = (".csv", ".csv.gz")
_BAG, _OURS = "metadata.yaml", "fuse.json"
_CHANGED = ("ETag", "etag", "mtime", "LastModified", "updated", "last_modified")


@dataclass(frozen=True)
class LogPlace:
    """A log: a file, or a folder of files that are one.

    url: as a program opens it; a path of this computer is absolute. size: bytes. stamp: of size and time of
    change, or what the store says of the content: the same as before, the log is taken to be the same.
    """

    url: str
    size: int
    stamp: str
    is_folder: bool = False

    @property
    def name(self) -> str:
        """The last part of its path."""
        return posixpath.basename(self.url)

    @property
    def folder(self) -> str:
        """The name of the folder that it lies in."""
        return posixpath.basename(posixpath.dirname(self.url))


def find_logs(words: Sequence[str], output: str) -> list[LogPlace]:
    """The logs of these files, folders, globs and URLs, each once, by name; what lies in `output` is none.

    Raises InputError for a word that stands for nothing and for no log at all, LinkError as `reached`.
    """
    found: dict[str, LogPlace] = {}
    own = url_of(*opened(output)) + "/"
    for word in words:
        fs, path = opened(word)
        path = path.rstrip("/") or path
        with reached(word):
            fs.invalidate_cache()
            places = list(_places(fs, path))
            there = bool(places) or fs.exists(path)
        if not there:
            raise InputError(f"{word}: is not there; name logs, folders, globs or URLs of them")
        found |= {place.url: place for place in places if not place.url.startswith(own)}
    if not found:
        raise InputError(
            f"{', '.join(words)}: no log in there; a log is .mcap, .bag, a rosbag2 or a CSV folder"
        )
    return [found[url] for url in sorted(found)]


def _places(fs: Any, path: str) -> Iterator[LogPlace]:
    if has_magic(path) and not fs.exists(path):
        for match, info in sorted(fs.glob(path, detail=True).items()):
            yield from _of_folder(fs, match) if info["type"] == "directory" else [_place(fs, match, [info])]
    elif fs.isdir(path):
        yield from _of_folder(fs, path)
    elif fs.isfile(path):
        yield _place(fs, path, [fs.info(path)])


def _of_folder(fs: Any, top: str) -> Iterator[LogPlace]:
    """What is a log in a folder and those below it; hidden files are none."""
    folders: dict[str, dict[str, Mapping[str, Any]]] = defaultdict(dict)
    for path, info in fs.find(top, detail=True).items():
        if not any(part.startswith(".") for part in path[len(top) :].split("/")):
            folder, name = posixpath.split(path)
            folders[folder][name] = info
    for folder, files in folders.items():
        csv = any(name.endswith(_CSV) for name in files) and _OURS not in files
        logs = [name for name in files if name.endswith(_LOGS)]
        if _BAG in files or (csv and not logs):
            yield _place(fs, folder, files.values(), is_folder=True)
        else:
            yield from (_place(fs, f"{folder}/{name}", [files[name]]) for name in logs)


def _place(fs: Any, path: str, infos: Iterable[Mapping[str, Any]], *, is_folder: bool = False) -> LogPlace:
    parts = sorted((info["name"], int(info["size"] or 0), _changed(info)) for info in infos)
    stamp = ";".join(f"{size} {changed}" for _, size, changed in parts)
    return LogPlace(url_of(fs, path), sum(size for _, size, _ in parts), stamp, is_folder)


def _changed(info: Mapping[str, Any]) -> str:
    return next((str(info[key]) for key in _CHANGED if info.get(key)), "")
