"""Paths and URLs as one thing: where logs come from, and where results go."""

from __future__ import annotations

import posixpath
from pathlib import Path
from typing import Any

from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

from hubodo.errors import InputError
from hubodo.whole_files import whole_files


def opened(word: str) -> tuple[Any, str]:
    """The file system of a path or URL, and the path in it. Raises InputError for one that cannot be used."""
    try:
        fs, path = url_to_fs(word)
    except (ValueError, ImportError) as error:
        raise InputError(f"{word}: {error}; s3:// and gs:// need pip install 'hubodo[cloud]'") from None
    return fs, str(path)


def url_of(fs: Any, path: str) -> str:
    """A path of this computer as it stands, another with its protocol."""
    return path if isinstance(fs, LocalFileSystem) else str(fs.unstrip_protocol(path))


def write_whole(fs: Any, path: str, data: bytes) -> None:
    """A file that is there whole or not at all; an earlier one is replaced, folders are made."""
    if not isinstance(fs, LocalFileSystem):
        fs.pipe_file(path, data)  # an object store shows an object when it is complete
        return
    fs.makedirs(posixpath.dirname(path), exist_ok=True)
    with whole_files(Path(path)) as (part,):
        part.write_bytes(data)
