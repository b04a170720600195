"""Reading of files with secrets, which is refused if anyone but the owner can read them."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from hubodo.errors import InputError


def read_private(path: Path, secret: str, encoding: str = "utf-8") -> str:
    """Return the text of a file that only its owner can read.

    Parameters
    ----------
    secret : what the file holds, for the message, such as "the token".

    Raises
    ------
    InputError
        If others can read the file; the message quotes nothing of the content.
    OSError, UnicodeDecodeError
        If the file cannot be read.
    """
    with path.open(encoding=encoding) as file:
        _refuse_shared(path, file.fileno(), secret)
        return file.read()


def check_private(path: Path, secret: str) -> None:
    """Raise InputError if others can read the file, OSError if it cannot be read."""
    with path.open("rb") as file:
        _refuse_shared(path, file.fileno(), secret)


def _refuse_shared(path: Path, descriptor: int, secret: str) -> None:
    """Raise InputError if anyone but the owner can read an open file."""
    # Test the open file, not its name, which another file could take in between.
    mode = os.fstat(descriptor).st_mode
    if stat.S_IMODE(mode) & 0o077 and os.name == "posix":
        raise InputError(f"{path}: others can read {secret}; run chmod 600 {path}")
