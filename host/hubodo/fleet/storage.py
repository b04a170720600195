"""Access to files by path or URL, for logs and results."""

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


def open_file_system(path_or_url: str) -> tuple[Any, str]:
    """Return the file system of a path or URL, and the path in it. Raises InputError if unsupported."""
    try:
        fs, path = url_to_fs(path_or_url)
    except (ValueError, ImportError) as error:
        raise InputError(
            f"{path_or_url}: {error}; s3:// and gs:// need pip install 'hubodo[cloud]'"
        ) from None
    return fs, str(path)


def format_url(fs: Any, path: str) -> str:
    """Return a local path unchanged, any other with its protocol."""
    return path if isinstance(fs, LocalFileSystem) else str(fs.unstrip_protocol(path))


@contextmanager
def report_store_errors(path_or_url: str) -> Iterator[None]:
    """Raise LinkError if a store is unreachable or refuses, whatever its client raises."""
    try:
        yield
    except Exception as error:  # noqa: BLE001 - each store's client has errors of its own
        text = " ".join(str(error).split())
        raise LinkError(
            f"{path_or_url}: {type(error).__name__}: {text}; check the address and the rights"
        ) from None


def write_atomically(fs: Any, path: str, data: bytes) -> None:
    """Write a file atomically, replacing an earlier one and creating folders."""
    if not isinstance(fs, LocalFileSystem):
        fs.pipe_file(path, data)  # an object store shows an object when it is complete
        return
    fs.makedirs(posixpath.dirname(path), exist_ok=True)
    with atomic_files(Path(path)) as (part,):
        part.write_bytes(data)
