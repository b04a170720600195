"""Writing TOML: keys, texts and numbers that read back as they were; a file that is whole or not there."""

import os
import re
import tempfile
from pathlib import Path

from hubodo.errors import InputError


def toml_key(name: str) -> str:
    """A bare key where the name allows one, else a quoted one."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_text(name)


def toml_text(text: str) -> str:
    """A basic string, all of it on one line."""
    escaped = "".join(
        f"\\u{ord(c):04x}" if ord(c) < 32 or ord(c) == 127 else f"\\{c}" if c in '\\"' else c for c in text
    )
    return f'"{escaped}"'


def toml_number(value: float) -> str:
    """A float with all its digits."""
    return repr(float(value))


def write_whole(path: Path, text: str) -> None:
    """Write a file whole or not at all; an existing one is replaced. InputError without its folder."""
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: its folder does not exist; create it first")
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.absolute().parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        mask = os.umask(0)
        os.umask(mask)
        Path(temporary).chmod(0o666 & ~mask)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
