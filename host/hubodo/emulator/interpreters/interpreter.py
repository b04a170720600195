"""Starts what runs the firmware: MicroPython or a whole emulated Pico under node, or CPython."""

from __future__ import annotations

import fcntl
import os
import struct
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal

from hubodo.emulator.interpreters.find import find_micropython, find_node, find_rp2040js
from hubodo.emulator.interpreters.rp2040.image import find_image
from hubodo.errors import HubodoError
from hubodo.safe_text import json_text

Kind = Literal["micropython", "cpython", "rp2040"]

_HERE = Path(__file__).parent


_LENGTH = struct.Struct("<I")
_idle: defaultdict[tuple[str, ...], list[Interpreter]] = defaultdict(list)
"""Those that wait for another board, by what they were started with: the next starts four times as fast."""


class InterpreterDied(HubodoError):
    """The interpreter ended by itself in a way no firmware can bring about."""


@dataclass
class Interpreter:
    """A running interpreter and the two pipes to it.

    alike: what it was started with, of those that more than one board can have; log: its last words.
    """

    alike: tuple[str, ...]
    process: subprocess.Popen[bytes]
    requests: int
    responses: int
    lifeline: int
    log: IO[bytes]
    _cpu_before: float = 0.0

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

    def let_go(self) -> None:
        """It was told that its board is off: another one may have it."""
        self._cpu_before += self.cpu()
        _idle[self.alike].append(self)

    def begin(self, settings: Mapping[str, object]) -> bool:
        """Tells it of its next board; False when it is gone."""
        text = json_text(settings).encode()
        try:
            os.write(self.responses, _LENGTH.pack(len(text)) + text)
        except BrokenPipeError:
            return False
        return True

    def cpu(self) -> float:
        """Processor time that it has taken for its board, s; 0 once it is gone."""
        try:
            stat = Path(f"/proc/{self.process.pid}/stat").read_text()
        except OSError:
            return 0.0
        fields = stat.rpartition(")")[2].split()
        taken = float(int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return taken - self._cpu_before

    def last_words(self) -> str:
        """The last lines it wrote to standard error."""
        self.log.seek(0)
        lines = self.log.read().decode("utf-8", "replace").strip().splitlines()
        return " / ".join(line[:200] for line in lines[-4:])


def require(kind: Kind, image: Path | None = None, bootrom: Path | None = None) -> None:
    """Sees that what an interpreter needs is there; image, bootrom: see `rp2040.image.find_image`.

    Raises:
        InterpreterMissing: node or an npm package is absent.
        ImageMissing: the image of MicroPython for the Pico, or the bootrom.
    """
    if kind == "micropython":
        find_node()
        find_micropython()
    elif kind == "rp2040":
        find_node()
        find_rp2040js()
        find_image(image, bootrom)


def start(kind: Kind, settings: Mapping[str, object]) -> Interpreter:
    """Start the interpreter with `settings` (see the runners)."""
    if kind != "micropython":
        runner = "rp2040/runner.mjs" if kind == "rp2040" else "cpython/runner.py"
        program = [find_node()] if kind == "rp2040" else [sys.executable, "-I", "-S"]
        return _start_process((*program, str(_HERE / runner)), settings)
    # It starts a tenth sooner without threads that would compile and collect for it.
    command = (find_node(), "--single-threaded", str(_HERE / "wasm" / "runner.mjs"))
    micropython = find_micropython().as_uri()
    alike = (*command, micropython)
    told = dict(settings, rom=str(_HERE / "modules"))
    while True:
        try:
            interpreter = _idle[alike].pop()
        except IndexError:
            interpreter = _start_process(command, {"micropython": micropython}, alike)
        if interpreter.begin(told):
            return interpreter
        interpreter.kill()


def _start_process(
    command: tuple[str, ...], settings: Mapping[str, object], alike: tuple[str, ...] = ()
) -> Interpreter:
    """A new process, which is told the settings and its pipes in its last argument."""
    request_read, request_write = os.pipe()
    response_read, response_write = os.pipe()
    life_read, life_write = os.pipe()
    theirs = (request_write, response_read, life_read)
    log = tempfile.TemporaryFile()  # noqa: SIM115  closed with the pipes
    process = subprocess.Popen(
        [*command, json_text(dict(settings, pipes=(request_write, response_read)))],
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        pass_fds=theirs,
        start_new_session=True,
    )
    # Once the board's process and with it this pipe is gone a signal ends the interpreter, even a busy loop.
    fcntl.fcntl(life_read, fcntl.F_SETOWN, process.pid)
    fcntl.fcntl(life_read, fcntl.F_SETFL, os.O_ASYNC)
    for fd in theirs:
        os.close(fd)
    return Interpreter(alike, process, request_read, response_write, life_write, log)
