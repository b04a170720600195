"""Start the interpreter of the firmware: MicroPython or an emulated Pico under node, or CPython."""

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

from hubodo.emulator.interpreters.find import find_micropython, find_node, require_rp2040js
from hubodo.emulator.interpreters.rp2040.image import find_image
from hubodo.errors import HubodoError
from hubodo.safe_text import json_text

InterpreterKind = Literal["micropython", "cpython", "rp2040"]

_INTERPRETERS = Path(__file__).parent


_SETTINGS_LENGTH = struct.Struct("<I")
_idle_interpreters: defaultdict[tuple[str, ...], list[Interpreter]] = defaultdict(list)
"""Interpreters that wait for another board, by command: reuse makes a start four times as fast."""


class InterpreterDied(HubodoError):
    """The interpreter ended in a way that no firmware can cause."""


@dataclass
class Interpreter:
    """A running interpreter and the two pipes to it.

    Attributes
    ----------
    shared_command : command line of an interpreter that several boards can use one after another; empty
        otherwise.
    process : its process.
    requests, responses, lifeline : file descriptors of the pipes.
    log : its standard output and error.
    """

    shared_command: tuple[str, ...]
    process: subprocess.Popen[bytes]
    requests: int
    responses: int
    lifeline: int
    log: IO[bytes]
    _cpu_before: float = 0.0

    def kill(self) -> None:
        """End the interpreter at once, as a reset does, and close the pipes."""
        self.process.kill()
        self.process.wait()
        self.close()

    def close(self) -> int:
        """Wait for the end of the process, close the pipes, and return the exit status."""
        status = self.process.wait()
        for fd in (self.requests, self.responses, self.lifeline):
            os.close(fd)
        self.log.close()
        return status

    def release(self) -> None:
        """Release an interpreter whose board is off, for reuse by another board."""
        self._cpu_before += self.cpu()
        _idle_interpreters[self.shared_command].append(self)

    def send_settings(self, settings: Mapping[str, object]) -> bool:
        """Send the settings of the next board; return False if the interpreter has ended."""
        text = json_text(settings).encode()
        try:
            os.write(self.responses, _SETTINGS_LENGTH.pack(len(text)) + text)
        except BrokenPipeError:
            return False
        return True

    def cpu(self) -> float:
        """Return the processor time used for this board, s; 0 if the process has ended."""
        try:
            stat = Path(f"/proc/{self.process.pid}/stat").read_text()
        except OSError:
            return 0.0
        fields = stat.rpartition(")")[2].split()
        used = float(int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return used - self._cpu_before

    def last_log_lines(self) -> str:
        """Return the last lines of its log."""
        self.log.seek(0)
        lines = self.log.read().decode("utf-8", "replace").strip().splitlines()
        return " / ".join(line[:200] for line in lines[-4:])


def check_available(kind: InterpreterKind, image: Path | None = None, bootrom: Path | None = None) -> None:
    """Check that everything an interpreter needs is installed; image, bootrom: see `rp2040.image.find_image`.

    Raises
    ------
    InterpreterMissing
        If node or an npm package is missing.
    ImageMissing
        If the MicroPython image for the Pico, or the bootrom, is missing.
    """
    if kind == "micropython":
        find_node()
        find_micropython()
    elif kind == "rp2040":
        find_node()
        require_rp2040js()
        find_image(image, bootrom)


def start_interpreter(kind: InterpreterKind, settings: Mapping[str, object]) -> Interpreter:
    """Start an interpreter with `settings` (see the runners)."""
    if kind != "micropython":
        runner = "rp2040/runner.mjs" if kind == "rp2040" else "cpython/runner.py"
        program = [find_node()] if kind == "rp2040" else [sys.executable, "-I", "-S"]
        return _start_process((*program, str(_INTERPRETERS / runner)), settings)
    # Single-threaded node starts 10 % faster.
    command = (find_node(), "--single-threaded", str(_INTERPRETERS / "wasm" / "runner.mjs"))
    micropython = find_micropython().as_uri()
    shared_command = (*command, micropython)
    settings_with_modules = dict(settings, rom=str(_INTERPRETERS / "modules"))
    while True:
        try:
            interpreter = _idle_interpreters[shared_command].pop()
        except IndexError:
            interpreter = _start_process(command, {"micropython": micropython}, shared_command)
        if interpreter.send_settings(settings_with_modules):
            return interpreter
        interpreter.kill()


def _start_process(
    command: tuple[str, ...], settings: Mapping[str, object], shared_command: tuple[str, ...] = ()
) -> Interpreter:
    """Start a process with the settings and its pipes as the last argument."""
    request_read, request_write = os.pipe()
    response_read, response_write = os.pipe()
    life_read, life_write = os.pipe()
    child_ends = (request_write, response_read, life_read)
    log = tempfile.TemporaryFile()  # noqa: SIM115  closed with the pipes
    process = subprocess.Popen(
        [*command, json_text(dict(settings, pipes=(request_write, response_read)))],
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        pass_fds=child_ends,
        start_new_session=True,
    )
    # When the process of the board ends, this pipe closes, and SIGIO ends even a busy interpreter.
    fcntl.fcntl(life_read, fcntl.F_SETOWN, process.pid)
    fcntl.fcntl(life_read, fcntl.F_SETFL, os.O_ASYNC)
    for fd in child_ends:
        os.close(fd)
    return Interpreter(shared_command, process, request_read, response_write, life_write, log)
