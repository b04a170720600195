"""Paths and URLs as one thing: where logs come from, and where results go."""

from __future__ import annotations

import posixpath
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fsspec.core import url_to_fs
from fsspec.implementations.local import LocalFileSystem

from hubodo.atomic_files import atomic_files
from hubodo.errors import InputError, LinkError


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


@contextmanager
def reached(word: str) -> Iterator[None]:
    """Raises LinkError where a store cannot be reached or refuses, whatever its own client calls that."""
    try:
        yield
    except Exception as error:  # noqa: BLE001 - each store's client has errors of its own
        text = " ".join(str(error).split())
        raise LinkError(f"{word}: {type(error).__name__}: {text}; check the address and the rights") from None


def write_whole(fs: Any, path: str, data: bytes) -> None:
    """A file that is there whole or not at all; an earlier one is replaced, folders are made."""
    if not isinstance(fs, LocalFileSystem):
        fs.pipe_file(path, data)  # an object store shows an object when it is complete
        return
    fs.makedirs(posixpath.dirname(path), exist_ok=True)
    with atomic_files(Path(path)) as (part,):
        part.write_bytes(data)
