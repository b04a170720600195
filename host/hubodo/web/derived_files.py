"""Files derived from recordings, in `pages/` beside them, accessed without following symbolic links.

Others may modify the folder at any time. Therefore each component of a path is opened relative to the one
before and refused if it is a link: nothing can be swapped between check and use.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
from collections.abc import Iterator, Sequence
from pathlib import Path

PAGES = "pages"
"""Folder beside the recordings, with a subfolder for each recording."""
_FOLDER_FLAGS = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_NOFOLLOW", 0)
_FILE_FLAGS = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
_NEW_FILE_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)


class DerivedFiles:
    """Access to derived files; `parts` are the path components below `pages/`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def is_fresh(self, parts: Sequence[str], since: float) -> bool:
        """Return True if the file exists and was written at `since` (s) or later."""
        try:
            with self._opened(parts, since):
                return True
        except OSError:
            return False

    def read(self, parts: Sequence[str], since: float) -> bytes | None:
        """Return the content of such a file, or None."""
        try:
            with self._opened(parts, since) as descriptor, os.fdopen(descriptor, "rb", closefd=False) as file:
                return file.read()
        except OSError:
            return None

    def check_folder(self, parts: Sequence[str]) -> None:
        """Raise OSError if a component of the folder exists and is no folder."""
        with contextlib.suppress(FileNotFoundError), self._folder_of(parts, create=False):
            pass

    def publish(self, parts: Sequence[str], source: Path) -> None:
        """Copy the plain files of `source` into a folder, each atomically."""
        with self._folder_of(parts, create=True) as folder:
            for file in sorted(source.iterdir()):
                if stat.S_ISREG(file.lstat().st_mode):
                    _replace(folder, file.name, file.read_bytes())

    @contextlib.contextmanager
    def _opened(self, parts: Sequence[str], since: float) -> Iterator[int]:
        with self._folder_of(parts[:-1], create=False) as folder:
            descriptor = os.open(parts[-1], _FILE_FLAGS, dir_fd=folder)
            try:
                status = os.fstat(descriptor)
                if not stat.S_ISREG(status.st_mode) or status.st_mtime < since:
                    raise FileNotFoundError(parts[-1])
                yield descriptor
            finally:
                os.close(descriptor)

    @contextlib.contextmanager
    def _folder_of(self, parts: Sequence[str], *, create: bool) -> Iterator[int]:
        # Only the folder of the recordings itself may be a link: the user chose it.
        descriptor = os.open(self._folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
        try:
            for name in (PAGES, *parts):
                if create:
                    with contextlib.suppress(FileExistsError):
                        os.mkdir(name, dir_fd=descriptor)
                child = os.open(name, _FOLDER_FLAGS, dir_fd=descriptor)
                os.close(descriptor)
                descriptor = child
            yield descriptor
        finally:
            os.close(descriptor)


def _replace(folder: int, name: str, content: bytes) -> None:
    part = f".{secrets.token_hex(8)}.part"
    try:
        with os.fdopen(os.open(part, _NEW_FILE_FLAGS, 0o666, dir_fd=folder), "wb") as file:
            file.write(content)
        os.replace(part, name, src_dir_fd=folder, dst_dir_fd=folder)
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(part, dir_fd=folder)
        raise
