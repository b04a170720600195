"""Files that are written completely or not at all: in a private folder first, then under their name.

The private folder lies beside the target, has a random name, and can be entered by its owner alone. So nobody
who may write to a shared folder can place a link where a file is about to be written.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from hubodo.errors import InputError


def require_free_path(path: Path) -> Path:
    """The path itself; raises InputError where something has it, or its folder does not exist."""
    if path.exists():
        raise InputError(f"{path}: exists already; choose another name or remove it, nothing is overwritten")
    _check_folder_exists(path)
    return path


@contextmanager
def atomic_files(*paths: Path, create_folder: bool = False) -> Iterator[list[Path]]:
    """Names to write under; what is there when the block ends well replaces `paths`, else it is removed.

    All or none: the first gets its name when the last is written. make_folder: their folder is made where it
    does not exist, and removed again after a failure. Raises InputError without it, OSError that names the
    file that was wanted (disk full, no rights).
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
    """The same for one file that must not exist (InputError), neither before nor when it gets its name."""
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
    """A folder to fill that becomes `folder` when the block ends well, else it is removed.

    Raises InputError where there is something in it already, OSError that names it.
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
    """Return a path to write to; the path itself where it is no file, as /dev/stdout."""
    return path if path.exists() and not path.is_file() else _path_in_private_folder(path)


def _path_in_private_folder(path: Path) -> Path:
    """Return a path of the same name in a new folder beside it, which only its owner can enter."""
    try:
        folder = tempfile.mkdtemp(prefix=".hubodo-", suffix=".part", dir=path.absolute().parent)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    return Path(folder) / path.name


def _resolve_target(path: Path) -> Path:
    """Return what is to be replaced: the file itself, or that to which a link of the user leads.

    Raises InputError for a link of somebody else: it could lead to any file of the user.
    """
    try:
        owner = path.lstat().st_uid if path.is_symlink() else None
    except FileNotFoundError:
        owner = None
    if owner is not None and hasattr(os, "geteuid") and owner not in (0, os.geteuid()):
        raise InputError(f"{path}: is a link of another user; remove it or choose another name")
    return path.resolve()


def _name_requested_file(error: BaseException, temporary: Mapping[Path, Path]) -> BaseException:
    """The error; one of the file system that names no file, or ours, with the file that was wanted."""
    if not isinstance(error, OSError) or error.errno is None:
        return error
    if error.filename is not None and Path(error.filename) not in temporary:
        return error
    requested = next(iter(temporary.values())) if error.filename is None else temporary[Path(error.filename)]
    return OSError(error.errno, error.strerror, str(requested))


def _check_folder_exists(path: Path) -> None:
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: its folder does not exist; create it first")


def _create_folders(folder: Path) -> list[Path]:
    """Make a folder and those above it; what was made, innermost first."""
    missing = []
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    for folder in reversed(missing):
        folder.mkdir()
    return missing


def _flush_to_disk(part: Path) -> None:
    # What is replaced cannot be made again: a power cut after the rename must not leave an empty file.
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
        # File systems without hard links (FAT on a memory card): check, then rename.
        if path.exists():
            raise InputError(already_exists) from None
        part.rename(path)
