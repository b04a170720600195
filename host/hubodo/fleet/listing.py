"""Find the logs in folders, globs and URLs, with a stamp that reveals changes without reading."""

from __future__ import annotations

import posixpath
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fsspec.core import has_magic

from hubodo.errors import InputError
from hubodo.fleet.storage import format_url, open_file_system, report_store_errors

_LOG_FILE_SUFFIXES = (".mcap", ".bag", ".db3")
_CSV_SUFFIXES = (".csv", ".csv.gz")
_BAG_METADATA, _FUSE_RESULT = "metadata.yaml", "fuse.json"
_CHANGE_KEYS = ("ETag", "etag", "mtime", "LastModified", "updated", "last_modified")


@dataclass(frozen=True)
class LogLocation:
    """The location of a log: a file, or a folder of files that form one log.

    Attributes
    ----------
    url : absolute path, or URL.
    size : bytes.
    stamp : size and modification time, or a content tag of the store; an equal stamp means an unchanged log.
    is_folder : True for a folder.
    """

    url: str
    size: int
    stamp: str
    is_folder: bool = False

    @property
    def name(self) -> str:
        """The last part of the path."""
        return posixpath.basename(self.url)

    @property
    def folder(self) -> str:
        """The name of the parent folder."""
        return posixpath.basename(posixpath.dirname(self.url))


def find_logs(sources: Sequence[str], output: str) -> list[LogLocation]:
    """Return the logs in these files, folders, globs and URLs, each once, sorted, without those in `output`.

    Raises InputError for a source that does not exist or if there is no log; LinkError if a store fails.
    """
    location_by_url: dict[str, LogLocation] = {}
    output_prefix = format_url(*open_file_system(output)) + "/"
    for word in sources:
        fs, path = open_file_system(word)
        path = path.rstrip("/") or path
        with report_store_errors(word):
            fs.invalidate_cache()
            locations = list(_locate_logs(fs, path))
            exists = bool(locations) or fs.exists(path)
        if not exists:
            raise InputError(f"{word}: does not exist; give logs, folders, globs or URLs of them")
        location_by_url |= {
            place.url: place for place in locations if not place.url.startswith(output_prefix)
        }
    if not location_by_url:
        raise InputError(
            f"{', '.join(sources)}: no log in there; a log is .mcap, .bag, a rosbag2 or a CSV folder"
        )
    return [location_by_url[url] for url in sorted(location_by_url)]


def _locate_logs(fs: Any, path: str) -> Iterator[LogLocation]:
    if has_magic(path) and not fs.exists(path):
        for match, info in sorted(fs.glob(path, detail=True).items()):
            yield from (
                _locate_in_folder(fs, match)
                if info["type"] == "directory"
                else [_make_location(fs, match, [info])]
            )
    elif fs.isdir(path):
        yield from _locate_in_folder(fs, path)
    elif fs.isfile(path):
        yield _make_location(fs, path, [fs.info(path)])


def _locate_in_folder(fs: Any, top: str) -> Iterator[LogLocation]:
    """Yield the logs in a folder and its subfolders, without hidden files."""
    folders: dict[str, dict[str, Mapping[str, Any]]] = defaultdict(dict)
    for path, info in fs.find(top, detail=True).items():
        if not any(part.startswith(".") for part in path[len(top) :].split("/")):
            folder, name = posixpath.split(path)
            folders[folder][name] = info
    for folder, files in folders.items():
        csv = any(name.endswith(_CSV_SUFFIXES) for name in files) and _FUSE_RESULT not in files
        logs = [name for name in files if name.endswith(_LOG_FILE_SUFFIXES)]
        if _BAG_METADATA in files or (csv and not logs):
            yield _make_location(fs, folder, files.values(), is_folder=True)
        else:
            yield from (_make_location(fs, f"{folder}/{name}", [files[name]]) for name in logs)


def _make_location(
    fs: Any, path: str, infos: Iterable[Mapping[str, Any]], *, is_folder: bool = False
) -> LogLocation:
    parts = sorted((info["name"], int(info["size"] or 0), _change_mark(info)) for info in infos)
    stamp = ";".join(f"{size} {changed}" for _, size, changed in parts)
    return LogLocation(format_url(fs, path), sum(size for _, size, _ in parts), stamp, is_folder)


def _change_mark(info: Mapping[str, Any]) -> str:
    return next((str(info[key]) for key in _CHANGE_KEYS if info.get(key)), "")
