"""Reading of files with secrets, refused where others than their owner can read them."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from hubodo.errors import InputError


def read_private(path: Path, secret: str, encoding: str = "utf-8") -> str:
    """Return the text of a file that nobody else may read.

    Parameters
    ----------
    secret : what the file holds, for the message, such as "the token".

    Raises
    ------
    InputError
        Where others may read the file; the message names no part of what is in it.
    OSError, UnicodeDecodeError
        Where it cannot be read.
    """
    with path.open(encoding=encoding) as file:
        _refuse_shared(path, file.fileno(), secret)
        return file.read()


def check_private(path: Path, secret: str) -> None:
    """Raise InputError where others can read the file, OSError where it cannot be read."""
    with path.open("rb") as file:
        _refuse_shared(path, file.fileno(), secret)


def _refuse_shared(path: Path, descriptor: int, secret: str) -> None:
    # Tests the open file, so that replacing the file under that name has no effect.
    """Raise InputError where others than the owner can read an open file."""
    mode = os.fstat(descriptor).st_mode
    if stat.S_IMODE(mode) & 0o077 and os.name == "posix":
        raise InputError(f"{path}: others can read {secret}; run chmod 600 {path}")
