"""Files that are written completely or not at all: first in a private folder, then moved to their name.

The private folder is in the folder of the target, has a random name, and only its owner can enter it. So
nobody with write access to a shared folder can place a link where a file is about to be written.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from hubodo.errors import InputError

StrPath = str | os.PathLike[str]


def require_free_path(path: Path) -> Path:
    """Return the path; raise InputError if it exists already or its folder is missing."""
    if path.exists():
        raise InputError(f"{path}: exists already; choose another name or remove it, nothing is overwritten")
    _check_folder_exists(path)
    return path


@contextmanager
def atomic_files(*paths: Path, create_folder: bool = False) -> Iterator[list[Path]]:
    """Yield temporary paths to write to; at the end of the block these files replace `paths`.

    All or none: no file is moved to its name before the last is written, and after a failure all are removed.
    create_folder: create a missing folder, and remove it again after a failure. Raises InputError for a
    missing folder, OSError with the requested file's name (disk full, no rights).
    """
    created_folders = _create_folders(paths[0].absolute().parent) if create_folder else []
    temporary: dict[Path, Path] = {}
    try:
        for path in paths:
            _check_folder_exists(path)
            temporary[_temporary_path(path)] = path
        yield list(temporary)
        for part, path in temporary.items():
            if part != path and path.exists():
                _flush_to_disk(part)
        for part, path in temporary.items():
            if part != path:
                part.replace(_resolve_target(path))
                _remove_temporary(part)
    except BaseException as error:
        for part, path in temporary.items():
            if part != path:
                _remove_temporary(part)
        for folder in created_folders:
            with suppress(OSError):
                folder.rmdir()
        if (renamed_error := _name_requested_file(error, temporary)) is not error:
            raise renamed_error from error
        raise


@contextmanager
def atomic_new_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path for a new file; raise InputError if the file exists, before or after writing."""
    require_free_path(path)
    part = _temporary_path(path)
    try:
        yield part
        _move_into_place(part, path)
    except OSError as error:
        if (named := _name_requested_file(error, {part: path})) is not error:
            raise named from error
        raise
    finally:
        _remove_temporary(part)


@contextmanager
def atomic_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder that becomes `folder` when the block succeeds, and else is removed.

    Raises InputError if the folder exists and is not empty, OSError with its name.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(
            f"{folder}: exists already and is not empty; choose another folder, nothing is overwritten"
        )
    if not folder.absolute().parent.is_dir():
        raise InputError(f"{folder}: its parent folder does not exist; create it first")
    part = _path_in_private_folder(folder)
    try:
        part.mkdir()
        yield part
        part.rename(folder)
    except BaseException as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise OSError(error.errno, error.strerror, str(folder)) from error
        raise
    finally:
        _remove_temporary(part)


def write_atomically(path: Path, text: str) -> None:
    """Write a text as UTF-8; an existing file is replaced. Raises as `atomic_files` does."""
    with atomic_files(path) as (part,):
        part.write_text(text, "utf-8", "backslashreplace")


def _remove_temporary(part: Path) -> None:
    shutil.rmtree(part.parent, ignore_errors=True)


def _temporary_path(path: Path) -> Path:
    """Return a temporary path to write to, or the path itself for a device such as /dev/stdout."""
    return path if path.exists() and not path.is_file() else _path_in_private_folder(path)


def _path_in_private_folder(path: Path) -> Path:
    """Return a path of the same name in a new folder beside the target that only its owner can enter."""
    try:
        folder = tempfile.mkdtemp(prefix=".hubodo-", suffix=".part", dir=path.absolute().parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    return Path(folder) / path.name


def _resolve_target(path: Path) -> Path:
    """Return the file to be replaced: the path itself, or the target of the user's own link.

    Raises InputError for a link of another user, which could point to any file of this user.
    """
    try:
        owner = path.lstat().st_uid if path.is_symlink() else None
    except FileNotFoundError:
        owner = None
    if owner is not None and hasattr(os, "geteuid") and owner not in (0, os.geteuid()):
        raise InputError(f"{path}: is a link of another user; remove it or choose another name")
    return path.resolve()


def _name_requested_file(error: BaseException, temporary: Mapping[Path, Path]) -> BaseException:
    """Return the error, naming the requested file if it names no file or a temporary one."""
    if not isinstance(error, OSError) or error.errno is None:
        return error
    if error.filename is not None and Path(error.filename) not in temporary:
        return error
    requested = next(iter(temporary.values())) if error.filename is None else temporary[Path(error.filename)]
    return OSError(error.errno, error.strerror, str(requested))


def _check_folder_exists(path: Path) -> None:
    folder = path.absolute().parent
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{path.parent}: is a file, and a folder is due here; name another folder")
    if not folder.is_dir():
        raise InputError(f"{path}: its folder does not exist; create it first")


def _create_folders(folder: Path) -> list[Path]:
    """Create a folder and its missing parents; return the created ones, innermost first."""
    missing = []
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    for folder in reversed(missing):
        folder.mkdir()
    return missing


def _flush_to_disk(part: Path) -> None:
    # Flush to disk first: a power cut right after the rename must not leave an empty file.
    handle = os.open(part, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _move_into_place(part: Path, path: Path) -> None:
    already_exists = f"{path}: exists already; choose another name or remove it, nothing is overwritten"
    try:
        os.link(part, path)
    except FileExistsError:
        raise InputError(already_exists) from None
    except OSError:
        # On file systems without hard links (FAT on a memory card), check for the target, then rename.
        if path.exists():
            raise InputError(already_exists) from None
        part.rename(path)
