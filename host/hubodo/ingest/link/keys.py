"""The key file of nodes on UDP, written by `hubodo flash` and read by `hubodo record`."""

from __future__ import annotations

import os
import re
import secrets
from pathlib import Path

from hubodo.atomic_files import atomic_files
from hubodo.errors import ConfigError, InputError
from hubodo.private_files import check_private
from hubodo.toml_file import load_toml, quote_value

KEY_BYTES = 32
_SERIAL = re.compile(r"[0-9a-f]{16}")
_KEY = re.compile(rf"[0-9a-f]{{{2 * KEY_BYTES}}}")


class KeyRing:
    """Keys by board serial (16 hexadecimal digits, as in its Hello), stored in a TOML file as ``[keys]``."""

    def __init__(self, path: Path, *, create: bool = False) -> None:
        """Read the file; with `create`, a missing file counts as one without keys.

        Raises InputError when the file is missing, ConfigError for an invalid key.
        """
        self.path = path
        self.keys: dict[str, bytes] = {}
        if not path.exists():
            if create:
                return
            raise InputError(f"{path}: no such file; `hubodo flash PORT --key-file {path}` creates it")
        table = load_toml(path)
        check_private(path, "the keys")
        rows = table.get("keys", {})
        if set(table) - {"keys"} or not isinstance(rows, dict):
            raise ConfigError(f'{path}: must hold one table [keys] with SERIAL = "KEY" and nothing else')
        for serial, key in rows.items():
            if not _SERIAL.fullmatch(serial) or not isinstance(key, str) or not _KEY.fullmatch(key):
                raise ConfigError(
                    f"{path}: [keys] {quote_value(serial)}: wants the serial of a board, 16 hexadecimal "
                    f"digits, and a key of {2 * KEY_BYTES}"
                )
            self.keys[serial] = bytes.fromhex(key)

    def get_or_create_key(self, serial: str) -> bytes:
        """Return the key of a board; a new key is stored in the file before it is returned."""
        if serial not in self.keys:
            self.keys[serial] = secrets.token_bytes(KEY_BYTES)
            self._write()
        return self.keys[serial]

    def _write(self) -> None:
        """Write the file atomically, readable by its owner only."""
        rows = "".join(f'{serial} = "{key.hex()}"\n' for serial, key in sorted(self.keys.items()))
        text = f"# Keys of nodes on UDP, by the serial of the board: as secret as a password.\n[keys]\n{rows}"
        with atomic_files(self.path) as (part,):
            descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(descriptor, "w") as file:
                file.write(text)
